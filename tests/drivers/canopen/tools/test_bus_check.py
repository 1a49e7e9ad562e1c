"""The bus check on simulated boards."""

from __future__ import annotations

from dataclasses import replace

import pytest

from drivers.canopen.faults import BusError
from drivers.canopen.tools.bus_check import BusCheck, CheckedBoard, check_bus
from drivers.canopen.wire import cia301
from drivers.canopen.wire.cia301 import State
from drivers.canopen.wire.events import BusChanged
from drivers.canopen.wiring import BusWiring, Channel, Timing, Wiring
from drivers.simulation.objects import Objects
from drivers.simulation.variants import VARIANTS
from tests.drivers.canopen.world import World, two_boards, two_buses


def asked(world: World, lose: str | None = None, timeout: float = 20.0, **changes: object) -> tuple[CheckedBoard, ...]:
    world.run(0.05)
    world.wiring = replace(world.wiring, **changes)
    world.stalled = False
    asking = BusCheck(world.wiring, world.timing, world.send)
    world.use(asking)
    world.frames()
    asking.start(world.now)
    if lose:
        asking.receive_event(BusChanged(lose, "down", "it is down", None), world.now)
    world.until(lambda: asking.answers is not None, timeout)
    return asking.answers


def test_every_board_says_what_it_is_and_nothing_on_it_changes():
    world = World(two_boards())
    world.boards.board("can0/9").objects.set_number(0x1000, 0, 0x00020191)
    fresh = World(two_boards()).boards.board("can0/5").objects
    good, other = asked(world)
    assert (good.board, good.ok, good.code) == ("can0/5", True, "")
    assert good.text.startswith("device type 00030191h, error register 00h; to be written: 1016h sub 1 (heartbeat of")
    assert (other.board, other.ok) == ("can0/9", True)
    assert "1000h sub 0 is 00020191h, without the bit of digital inputs" in other.text
    held = world.boards.board("can0/5").objects
    assert all(held.number(*place) == fresh.number(*place) for place in held._values)
    assert not any(cob_id < 0x580 for cob_id, _ in world.frames())


def test_an_error_register_is_told():
    world = World()
    world.boards.board("can0/5").objects.set_number(0x1001, 0, 0x81)
    [answer] = asked(world)
    assert (answer.ok, answer.code) == (False, "board-error")
    assert "error register 1001h sub 0 is 81h; 00h is needed" in answer.text


@pytest.mark.parametrize("on_loss", ["hold", "contract"])
@pytest.mark.parametrize("name", VARIANTS)
def test_no_write_changes_a_value_so_no_lost_frame_and_no_kill_leaves_one(monkeypatch, name, on_loss):
    world = World(two_boards(), variants={"can0/5": VARIANTS[name]})
    world.run(6.0)
    changed = []
    write = Objects.set_data

    def watched(objects, index, sub, data, check_writable=False):
        before = objects.get_data(index, sub)
        write(objects, index, sub, data, check_writable)
        if objects.get_data(index, sub) != before or bytes(data) != before:
            changed.append(f"{index:04X}h sub {sub}: {before.hex()} to {data.hex()}")

    monkeypatch.setattr(Objects, "set_data", watched)
    asked(world, timeout=60.0, on_loss=on_loss)
    assert changed == []


def test_a_lost_answer_leaves_the_error_mode_of_a_running_arm():
    world = World(two_boards(), on_loss="hold").up()
    world.lost = lambda bus, frame: frame.id == 0x585 and frame.data[0] == 0x60
    world.stalled = True
    [told, _] = asked(world, on_loss="contract")
    assert told.code == "board-missing"
    objects = world.boards.board("can0/5").objects
    assert [objects.number(0x6206, 1), objects.number(0x1029, 1)] == [0xFE, 0]


@pytest.mark.parametrize("variant", ["standard", "one-supervision"])
def test_a_stopped_board_is_said_to_be_stopped(variant):
    world = World(two_boards(), variants={"can0/5": VARIANTS[variant]}).up()
    if variant != "standard":  # guarded: no heartbeat tells the state
        world.boards.board("can0/5").objects.set_number(0x1017, 0, 0)
        world.boards.board("can0/5")._supervision.begin(world.now)
    world.stalled = True
    world.say(cia301.NMT, bytes([cia301.Command.STOP, 5]))
    world.run(1.0)
    assert world.boards.board("can0/5").state is State.STOPPED
    five, nine = asked(world)
    assert (five.code, nine.ok) == ("board-stopped", True)
    assert five.text == (
        "board can0/5 is stopped, as after the end of an executor with on_loss: contract; it answers no SDO: start the"
        " executor, or reset the board: hyperbit board ARM.yaml can0/5 reset"
    )


def test_a_board_that_is_heard_and_does_not_answer_is_not_asked_for_its_power():
    world = World(two_boards()).up()
    world.lost = lambda bus, frame: frame.id == 0x585
    five, _ = asked(world)
    assert (five.code, "board can0/5 is pre-operational, but does not answer" in five.text) == ("board-missing", True)


def test_the_heartbeat_of_an_executor_is_heard():
    world = World(two_boards())
    world.run(0.05)
    asking = BusCheck(world.wiring, world.timing, world.send)
    world.use(asking)
    asking.start(world.now)
    assert asking.master_on is None
    world.say(cia301.HEARTBEAT + 0x7F, b"\x05")
    world.until(lambda: asking.over)
    assert asking.master_on == "can0"


def test_silent_boards_are_asked_in_parallel():
    world = World([Channel(str(n), "can0", n, 0, 0) for n in range(1, 101)])
    for node in range(1, 101):
        world.fault("silence", f"can0/{node}")
    begun = world.now
    answers = asked(world)
    assert not any(answer.ok for answer in answers)
    assert "can0/1 neither booted nor answered" in answers[0].text
    assert {answer.code for answer in answers} == {"board-missing"}
    assert world.now - begun < 2.5


def test_boards_of_a_lost_bus_do_not_answer():
    good, lost = asked(World(two_buses()), lose="can1")
    assert (good.ok, lost.ok) == (True, False)
    assert "can1/5 does not answer: can1: it is down" in lost.text


def test_a_bus_that_cannot_be_opened_is_told():
    bus = BusWiring("can0", "socketcan", "no-such-interface")
    with pytest.raises(BusError, match="no-such-interface"):
        check_bus(Wiring((bus,), (Channel("a", "can0", 5, 0, 0),)), Timing())


def test_an_empty_bus():
    bus = BusWiring("can0", "virtual", "test_probe")
    asking = check_bus(Wiring((bus,), (Channel("a", "can0", 5, 0, 0),)), Timing())
    assert asking.master_on is None
    [answer] = asking.answers
    assert "can0/5 neither booted nor answered" in answer.text
