"""The boot of boards: success, the frames and times of its steps, and refusals with their reasons."""

from __future__ import annotations

import itertools
from dataclasses import replace

import pytest

from hyperbit.drivers.canopen.boot import quirks
from hyperbit.drivers.canopen.boot.quirks import NONE, QUIRKS, Quirk, quirk_of
from hyperbit.drivers.canopen.wire.cia301 import SDO_ANSWER, SDO_REQUEST, Command, Frame, State
from hyperbit.drivers.canopen.wire.events import BusChanged
from hyperbit.drivers.canopen.wiring import Channel, NodeWiring, Timing
from hyperbit.drivers.simulation.buses import board_names
from hyperbit.drivers.simulation.dictionary import array
from hyperbit.drivers.simulation.variants import STANDARD, VARIANTS
from tests.drivers.rig import TICK, World, each_node, two_boards, two_buses

ABSENT, NO_SUB_INDEX, PRESENT_STATE = 0x06020000, 0x06090011, 0x08000022
PRE_OPERATIONAL = (0, "80 05")
MANY = VARIANTS["many-outputs"]


def codes(world: World) -> list[tuple[str, str]]:
    return [(fault.source, fault.code) for fault in world.boot()]


# Boards that are not there, refuse, or are other devices.


def test_every_board_has_its_own_fault_and_the_others_come_up() -> None:
    world = World(each_node(5), Timing(boot_timeout=0.2))
    world.fault("silence", "can0/1")
    world.board("can0/2").objects.refused[0x1000, 0] = 0x08000000
    world.board("can0/3").objects.refused[0x1016, 1] = 0x06090030
    refused = [("can0/1", "board-missing"), ("can0/2", "sdo-refused"), ("can0/3", "sdo-refused")]
    assert codes(world) == refused
    assert (world.measured(), world.master.outputs_known) == ([-1, -1, -1, 0, 0], False)
    world.fault("unsilence", "can0/1")
    assert codes(world) == refused[1:]


@pytest.mark.parametrize(("busy", "told"), [(2.0, []), (20.0, [("can0/5", "sdo-refused")])])
@pytest.mark.parametrize("kinds", [(0x20,), (0x20, 0x40)], ids=["writes", "writes and reads"])
def test_a_board_that_refuses_for_its_present_state_is_asked_until_the_boot_timeout(
    kinds: tuple[int, ...], busy: float, told: list[tuple[str, str]]
) -> None:
    world = World(timing=Timing(boot_timeout=5.0))
    begun = world.now

    def refuse(frame: Frame) -> bool:
        if frame.id != SDO_REQUEST + 5 or frame.data[0] & 0xE0 not in kinds or world.now > begun + busy:
            return False
        world.say(SDO_ANSWER + 5, b"\x80" + frame.data[1:4] + PRESENT_STATE.to_bytes(4, "little"))
        return True

    world.deaf = refuse
    assert codes(world) == told
    assert world.now - begun > min(busy, 5.0)
    assert all("08000022h" in fault.message for fault in world.master.booting.faults)


def test_a_board_without_inputs_is_right_if_none_is_wired() -> None:
    world = World([Channel("a", "can0", 5, 0, None)])
    world.objects.set_number(0x1000, 0, 0x00020191)
    assert world.boot() == []
    assert not any(data[3:8] in ("00 18", "00 1a") for data in world.requests())


@pytest.mark.parametrize("absent", [(0x1006, 0), (0x1029, 1), (0x6005, 0), (0x1400, 5), (0x1800, 5)])
def test_optional_objects_may_be_absent(absent: tuple[int, int]) -> None:
    world = World()
    world.objects.refused[absent] = NO_SUB_INDEX if absent[1] else ABSENT
    world.up()


@pytest.mark.parametrize(
    ("named", "words"),
    [
        ({"vendor": 0x22}, "1018h sub 1 (vendor)"),
        ({"product": 7}, "1018h sub 2 (product)"),
        ({"revision": 7}, "1018h sub 3 (revision)"),
        ({"serial": 7}, "1018h sub 4 (serial number)"),
    ],
)
def test_another_device_than_the_arms_file_names_is_refused(named: dict[str, int], words: str) -> None:
    world = World(nodes=(NodeWiring("can0", 5, **named),))
    place = 0x1018, int(words[10])
    world.objects.set_number(*place, 1)
    [fault] = world.boot()
    [number] = named.values()
    assert fault.code == "wrong-device"
    assert words in fault.message
    assert f"{number:08X}h is needed" in fault.message
    world.objects.set_number(*place, number)
    world.up()


def test_quirks_are_found_by_vendor_and_product_and_name_device_and_source(monkeypatch: pytest.MonkeyPatch) -> None:
    special, other = Quirk("special", "made up", ignored_errors=0x80), Quirk("other", "made up")
    monkeypatch.setitem(quirks.QUIRKS, (1, 2), special)
    monkeypatch.setitem(quirks.QUIRKS, (1, None), other)
    assert (quirk_of(1, 2), quirk_of(1, 3), quirk_of(2, 2), quirk_of(None, None)) == (special, other, NONE, NONE)
    assert all(quirk.device and quirk.source for quirk in QUIRKS.values())


def test_a_quirk_takes_a_bit_of_the_error_register_as_no_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    world = World(variant="standing-error")
    quirk = Quirk("special", "made up", ignored_errors=0x80)
    monkeypatch.setitem(quirks.QUIRKS, (world.objects.number(0x1018, 1), None), quirk)
    world.up()
    world.run(3.0)
    assert world.faults == []


def test_a_board_that_starts_anew_again_and_again_is_given_up() -> None:
    world = World()

    def cut() -> None:
        world.cycle_power()
        world.after(0.01, cut)

    world.after(0.055, cut)
    assert codes(world) == [("can0/5", "board-rebooted")]


def test_a_stopped_board_that_is_refused_by_its_first_answer_is_stopped_again() -> None:
    world = World().up()
    world.nmt(Command.STOP)
    world.run(0.5)
    world.objects.refused[0x1000, 0] = ABSENT
    [fault] = world.boot()
    assert ("1000h sub 0" in fault.message, world.board().state) == (True, State.STOPPED)


def test_a_stopped_board_boots_also_if_the_boot_timeout_is_as_short_as_the_first_question() -> None:
    world = World(timing=Timing(boot_timeout=0.5), variant="guarding-with-1029h")
    world.board().obey(Command.STOP)
    world.up()
    assert world.board().state is State.OPERATIONAL


# Buses, and another master.


def test_a_second_master_switches_nothing_and_adopts_the_states() -> None:
    world = World(two_boards()).up()
    world.commit(1, 0, then=0.1)
    world.new_master()
    world.frames()
    assert world.boot() == []
    assert not any(cob_id == 0 for cob_id, _ in world.frames()), "no board had to leave operational"
    assert world.measured() == [1, 0]
    world.commit(1, 0)
    assert (world.frames(), world.switches()) == ([], [1, 0])


@pytest.mark.parametrize(("state", "code"), [("bus-off", "bus-off"), ("closed", "bus-down")])
def test_a_bus_that_is_lost_or_not_open_ends_the_boot_of_its_boards_only(state: str, code: str) -> None:
    world = World(two_buses())
    lost = BusChanged("can1", state, "", None)
    world.after(0.06 if state == "bus-off" else 0.0, lambda: world.master.receive_event(lost, world.now))
    assert codes(world) == [("can1", code)]
    assert world.measured() == [0, -1]


def test_boot_needs_no_echo() -> None:
    world = World(two_boards())
    world.buses["can0"].echoes = False
    world.up()
    world.commit(1, 0, then=0.1)
    assert world.measured() == [1, 0]


def boot_time(world: World) -> float:
    """Returns the time from a start without power to the end of the boot; all boards get power after 0.5 s [s]."""
    boards, begun = board_names(world.wiring), world.now
    for board in boards:
        world.fault("power_cut", board)
    for bus in world.buses.values():
        bus.mailboxes = 1  # with three that compete by identifier, heartbeats wait, and 100 boards take 0.4 s more
    world.after(0.5, lambda: [world.fault("power_on", board) for board in boards])
    world.up()
    return world.now - begun


def test_a_hundred_boards_boot_in_at_most_three_times_the_time_of_one() -> None:
    many = World(each_node(100), latency=0.008)
    one, hundred = boot_time(World(each_node(1), latency=0.008)), boot_time(many)
    assert hundred <= 3 * one
    assert hundred - 0.5 < 2
    assert many.master.status().buses[0].dropped == 0, "a small transmit queue is not overrun"


def test_the_heartbeat_of_the_master_keeps_its_time_on_a_slow_bus_while_many_boards_boot() -> None:
    world = World(each_node(60), bitrate=125_000).up()
    world.run(1.0)
    assert world.faults == []
    assert max(after - before for before, after in itertools.pairwise(world.beats)) < world.timing.heartbeat_timeout


# Single steps.


def test_another_cob_id_that_cannot_be_written_is_refused() -> None:
    world = World(variant=replace(STANDARD, read_only=frozenset({0x1400})))
    world.objects.set_number(0x1400, 1, 0x555)
    [fault] = world.boot()
    assert fault.code == "sdo-refused"
    assert fault.message.startswith("board can0/5: RPDO1 has the COB-ID 00000555h in 1400h sub 1, not 205h;")


@pytest.mark.parametrize(("others", "entry"), [([], 1), ([16], 2), ([16, 17], 3), ([16, 17, 18], 1)])
def test_the_master_is_watched_in_the_first_free_entry(others: list[int], entry: int) -> None:
    entries = [node << 16 | 500 for node in others] + [0] * (3 - len(others))
    world = World(variant=replace(STANDARD, changes=array(0x1016, entries, size=4))).up()
    assert [sub for sub in (1, 2, 3) if world.objects.number(0x1016, sub) >> 16 == 127] == [entry]


def test_a_guarded_board_that_does_not_tell_its_state_is_made_to_before_it_is_ordered_anything() -> None:
    world = World(variant="guarding-with-1029h", on_loss="contract").up()
    world.run(0.3)
    world.timing = Timing(heartbeat=0.05, heartbeat_timeout=0.35)
    world.new_master()
    assert world.boot() == []
    sent = [frame for frame in world.frames(sdo=True) if frame[0] in (0, 0x605)]
    assert [data for _, data in sent[: sent.index(PRE_OPERATIONAL)] if data.startswith("2")] == [
        "2b 0c 10 00 32 00 00 00",
        "2f 0d 10 00 07 00 00 00",
        "2f 06 62 01 fc 00 00 00",
    ], "the guard time, the life time factor, and outputs that hold"


@pytest.mark.parametrize(("on_loss", "early"), [("hold", True), ("contract", False)])
def test_outputs_that_go_off_without_the_master_are_set_to_it_after_the_start_only(on_loss: str, early: bool) -> None:
    world = World(on_loss="hold" if on_loss == "contract" else "contract").up()
    world.new_master(on_loss=on_loss)
    assert world.boot() == []
    sent = [data for cob_id, data in world.frames(sdo=True) if cob_id in (0, 0x605)]
    [written] = [k for k, data in enumerate(sent) if data.startswith("2f 06 62 01")]
    assert (written < sent.index("01 05")) is early


def test_the_boot_goes_on_with_the_echo_of_an_order() -> None:
    world = World().up()
    world.run(0.2)
    world.timing = Timing(heartbeat=0.03)
    world.new_master()
    world.master.boot(world.now)
    world.until(lambda: PRE_OPERATIONAL in world.frames(sdo=True))
    assert world.until(world.requests) < TICK / 10


def test_the_shared_rpdo_of_two_boards_has_gaps_for_the_bytes_of_the_other() -> None:
    world = World(two_boards(), shared_rpdo=True)
    assert world.boot() == []
    frames = world.frames(sdo=True)
    left, right = ([data for cob_id, data in frames if cob_id == 0x600 + node] for node in (5, 9))
    assert "40 00 16 01 00 00 00 00" in left, "the first object is mapped already"
    assert "23 00 16 02 08 00 05 00" in left, "the second byte is for another board"
    assert "23 00 16 01 08 00 05 00" in right, "the first byte is for another board"
    assert "23 00 16 02 08 01 00 62" in right
    assert "23 00 14 01 05 02 00 00" in right, "both take 205h"


# Mappings that boards bring.


def test_a_fixed_mapping_is_used_as_it_is_and_other_outputs_keep_their_values() -> None:
    world = World(variant="fixed-mapping")
    world.objects.set_number(0x6206, 3, 0x00)  # its outputs hold in the error state
    world.objects.set_number(0x6200, 3, 0x40)
    world.up()
    world.commit(1, 0)
    assert world.frames()[:2] == [(0x205, "01 00 40 00 00 00 00 00"), (0x080, "")]


@pytest.mark.parametrize("fixed", [False, True])
@pytest.mark.parametrize("bytes_used", [(0, 9), tuple(range(10))], ids=["one PDO", "two PDOs"])
def test_outputs_beyond_the_first_64_switch_with_the_same_sync(bytes_used: tuple[int, ...], fixed: bool) -> None:
    """With fixed mappings both RPDO1 and RPDO5 are needed unchanged."""
    read_only = frozenset((0x1600, 0x1604, 0x1A00, 0x1A04) if fixed else ())
    channels = [Channel(f"{k}", "can0", 5, 8 * k, 64 * k if k < 2 else None) for k in bytes_used]
    world = World(channels, variant=replace(MANY, read_only=read_only)).up()
    rest = [1] * (len(channels) - 1)
    world.commit(1, *rest)
    frames = world.frames()
    sync = frames.index((0x080, ""))
    assert sync == (2 if fixed or len(channels) > 8 else 1)
    assert all(cob_id in (0x205, 0x305) for cob_id, _ in frames[:sync])
    world.run(2.5)
    assert (world.positions(), world.faults) == ([1, *rest], [])
    if sync == 2:
        assert world.objects.number(0x1404, 1) == 0x305
        assert world.objects.number(0x1401, 1) >> 31, "RPDO2 had 305h for analog outputs"
    world.commit(*rest, 0)
    world.run(0.2)
    assert world.positions() == [*rest, 0]
    world.new_master()
    world.up()
    assert world.positions() == [*rest, 0]


@pytest.mark.parametrize("synchronous", [True, False])
def test_a_pair_in_two_rpdos_needs_sync(synchronous: bool) -> None:
    variant = replace(MANY, synchronous=synchronous, read_only=frozenset({0x1600, 0x1604}))
    faults = World([Channel("5.left", "can0", 5, 0, None, output_off=64)], variant=variant).boot()
    sentence = "outputs 0 and 64 of one actuator are in RPDO1 and RPDO5, which do not wait for SYNC"
    assert [sentence in fault.message for fault in faults] == ([] if synchronous else [True])
