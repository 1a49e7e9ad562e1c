"""The boot of boards: success, refusals with their reasons, and no switch of an output."""

from __future__ import annotations

import itertools

import pytest

from hyperbit.drivers.canopen.wire.events import BusChanged, FrameEchoed
from hyperbit.drivers.canopen.wiring import Channel, Timing
from hyperbit.drivers.simulation.buses import board_names
from tests.drivers.rig import World, two_boards, two_buses


def many(boards: int, buses: int = 1) -> list[Channel]:
    return [Channel(f"{b}.{n}", f"can{b}", n, 0, 0) for b in range(buses) for n in range(1, 1 + boards // buses)]


def test_a_missing_board_is_named_and_the_others_come_up():
    world = World(two_boards(), Timing(boot_timeout=0.2))
    world.boards.board("can0/5").silent = True
    world.boot()
    [fault] = world.master.boot_faults
    assert (fault.code, fault.source) == ("board-missing", "can0/5")
    assert world.measured() == [-1, 0]
    assert not world.master.outputs_known
    world.boards.board("can0/5").silent = False
    world.up()


@pytest.mark.parametrize(("busy", "codes"), [(2.0, []), (20.0, ["sdo-refused"])])
@pytest.mark.parametrize("kinds", [(0x20,), (0x20, 0x40)])  # writes; and reads
def test_a_board_that_refuses_for_its_present_state_is_asked_until_the_boot_timeout(busy, codes, kinds):
    world = World(timing=Timing(boot_timeout=5.0))
    board = world.boards.board("can0/5")
    serve, until = board._serve, world.now + busy

    def answer(data: bytes) -> None:
        if data[0] & 0xE0 in kinds and world.now < until:
            board.send_message(0x585, bytes([0x80]) + data[1:4] + (0x08000022).to_bytes(4, "little"))
        else:
            serve(data)

    board._serve = answer
    begun = world.now
    world.run(0.05)
    world.master.boot(world.now)
    world.until(lambda: not world.master.booting, 30)
    assert [fault.code for fault in world.master.boot_faults] == codes
    assert world.now - begun > min(busy, 5.0)
    assert all("08000022h" in fault.message for fault in world.master.boot_faults)


def test_every_board_has_its_own_fault():
    world = World(many(4), Timing(boot_timeout=0.2))
    world.boards.board("can0/1").silent = True
    world.boards.board("can0/2").objects.refused[0x1000, 0] = 0x08000000
    world.boards.board("can0/3").objects.refused[0x1016, 1] = 0x06090030
    world.boot()
    assert [(f.source, f.code) for f in world.master.boot_faults] == [
        ("can0/1", "board-missing"),
        ("can0/2", "sdo-refused"),
        ("can0/3", "sdo-refused"),
    ]


@pytest.mark.parametrize(("device_type", "what"), [(0x00010191, "outputs"), (0x00020191, "inputs")])
def test_a_bit_that_is_missing_in_the_device_type_is_told_and_the_objects_decide(device_type, what):
    world = World()
    board = world.boards.board("can0/5").objects
    board.set_number(0x1000, 0, device_type)
    world.up()
    [warning] = world.master.warnings()
    assert (warning.code, warning.source) == ("board-limits", "can0/5")
    assert f"without the bit of digital {what}" in warning.message
    board.refused[0x6200 if what == "outputs" else 0x6000, 0] = 0x06020000
    world.boot()
    [fault] = world.master.boot_faults
    assert (fault.code, f"has no {what}" in fault.message) == ("wrong-device", True)


def test_a_board_without_inputs_is_right_if_none_is_wired():
    world = World([Channel("a", "can0", 5, 0, None)])
    world.boards.board("can0/5").objects.set_number(0x1000, 0, 0x00020191)
    world.boot()
    assert world.master.boot_faults == []
    assert not any(data[3:8] in ("00 18", "00 1a") for cob_id, data in world.frames(sdo=True) if cob_id == 0x605)


@pytest.mark.parametrize("absent", [(0x1006, 0), (0x1029, 1), (0x6005, 0), (0x1400, 5), (0x1800, 5)])
def test_optional_objects_may_be_absent(absent):
    world = World()
    world.boards.board("can0/5").objects.refused[absent] = 0x06020000 if absent[1] == 0 else 0x06090011
    world.up()


def test_a_board_that_starts_anew_again_and_again_is_given_up():
    world = World()

    def cut():
        world.cycle_power("can0/5")
        world.after(0.01, cut)

    world.after(0.055, cut)
    world.boot()
    [fault] = world.master.boot_faults
    assert (fault.code, fault.source) == ("board-rebooted", "can0/5")


def test_a_second_master_switches_nothing_and_adopts_the_states():
    world = World(two_boards()).up()
    world.commit(1, 0, then=0.1)
    world.new_master()
    world.frames()
    world.boot()
    assert world.master.boot_faults == []
    assert not any(cob_id == 0 for cob_id, _ in world.frames())  # no board had to leave operational
    assert world.measured() == [1, 0]
    world.commit(1, 0)
    assert world.frames() == []
    assert world.switches() == [1, 0]


def test_a_bus_that_is_lost_while_booting_ends_the_boot_of_its_boards():
    world = World(two_buses())
    world.run(0.05)
    world.master.boot(world.now)
    world.run(0.01)
    world.buses["can1"].go_off()
    world.until(lambda: not world.master.booting)
    assert [(f.code, f.source) for f in world.master.boot_faults] == [("bus-off", "can1")]
    assert world.measured() == [0, -1]


def test_a_bus_that_is_not_open_is_named():
    world = World(two_buses())
    world.master.receive_event(BusChanged("can1", "closed", "", None), world.now)
    world.boot()
    assert [(f.code, f.source) for f in world.master.boot_faults] == [("bus-down", "can1")]


def test_boot_needs_no_echo():
    world = World(two_boards())
    world.buses["can0"].echoes = False
    world.up()
    world.commit(1, 0, then=0.1)
    assert world.measured() == [1, 0]


def test_a_small_transmit_queue_is_not_overrun():
    world = World(many(100)).up()
    assert world.master.status().buses[0].dropped == 0


def boot_time(world):
    """Returns the time from a start without power to the end of the boot; all boards get power after 0.5 s [s]."""
    boards, begun = board_names(world.wiring), world.now
    for board in boards:
        world.fault("power_cut", board)
    for bus in world.buses.values():
        bus.mailboxes = 1  # with three that compete by identifier, heartbeats wait, and 100 boards take 0.4 s more
    world.after(0.5, lambda: [world.fault("power_on", board) for board in boards])
    world.up()
    return world.now - begun


def test_a_hundred_boards_boot_in_at_most_three_times_the_time_of_one():
    def booted(channels):
        return boot_time(World(channels, latency=0.008))

    one, hundred = booted(many(1)), booted(many(100))
    assert hundred <= 3 * one
    assert hundred - 0.5 < 2


def test_the_heartbeat_of_the_master_keeps_its_time_on_a_slow_bus_while_many_boards_boot():
    world = World(many(60), bitrate=125_000)
    beats: list[float] = []
    receive_event = world.master.receive_event

    def note(event, now):
        if isinstance(event, FrameEchoed) and event.frame.id == 0x77F:
            beats.append(now)
        receive_event(event, now)

    world.master.receive_event = note
    world.up()
    world.run(1.0)
    assert world.faults == []
    gaps = [after - before for before, after in itertools.pairwise(beats)]
    assert max(gaps) < world.timing.heartbeat_timeout
