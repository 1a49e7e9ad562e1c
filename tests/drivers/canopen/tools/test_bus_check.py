"""The bus check on simulated boards."""

from __future__ import annotations

from dataclasses import replace

import pytest

from hyperbit.drivers.canopen.faults import BusError
from hyperbit.drivers.canopen.tools.bus_check import CheckedBoard, check_bus
from hyperbit.drivers.canopen.tools.session import MasterHeard, Session
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.bus import CanBus
from hyperbit.drivers.canopen.wire.cia301 import State
from hyperbit.drivers.canopen.wire.events import BusChanged
from hyperbit.drivers.canopen.wiring import BusWiring, Channel
from hyperbit.drivers.simulation.objects import Objects
from hyperbit.drivers.simulation.variants import VARIANTS
from tests.drivers.canopen.tools.sessions import session
from tests.drivers.rig import World, two_boards, two_buses


def asked(world: World, lose: str | None = None, **changes: object) -> list[CheckedBoard]:
    with session(world) as asking:
        world.frames()
        if lose:
            asking.lose(lose)
        return check_bus(asking, replace(world.wiring, **changes), world.timing)


def test_every_board_says_what_it_is_and_nothing_on_it_changes():
    world = World(two_boards())
    world.boards.board("can0/9").objects.set_number(0x1000, 0, 0x00020191)
    fresh = World(two_boards()).boards.board("can0/5").objects
    good, other = asked(world)
    assert (good.board, good.code) == ("can0/5", "")
    assert good.text.startswith("can be booted: device type 00030191h, error register 00h; to be written: 1016h sub 1")
    assert (other.board, other.code) == ("can0/9", "")
    assert "1000h sub 0 is 00020191h, without the bit of digital inputs" in other.text
    held = world.boards.board("can0/5").objects
    assert all(held.number(*place) == fresh.number(*place) for place in held.values)
    assert not any(cob_id < 0x580 for cob_id, _ in world.frames())


def test_an_error_register_is_told():
    world = World()
    world.boards.board("can0/5").objects.set_number(0x1001, 0, 0x81)
    [answer] = asked(world)
    assert answer.code == "board-error"
    assert "error register 1001h sub 0 is 81h; 00h is needed" in answer.text


@pytest.mark.parametrize("name", VARIANTS)
def test_no_write_changes_a_value_so_no_lost_frame_and_no_kill_leaves_one(monkeypatch, name):
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
    asked(world, on_loss="contract")
    assert changed == []


def test_a_lost_answer_leaves_the_error_mode_of_a_running_arm():
    world = World(two_boards(), on_loss="hold").up()
    world.lost = lambda bus, frame: frame.id == 0x585 and frame.data[0] == 0x60
    world.stalled = True
    [told, _] = asked(world, on_loss="contract")
    assert told.code == "sdo-unanswered"
    objects = world.boards.board("can0/5").objects
    assert [objects.number(0x6206, 1), objects.number(0x1029, 1)] == [0xFE, 0]


@pytest.mark.parametrize("variant", ["standard", "one-supervision"])
def test_a_stopped_board_is_said_to_be_stopped(variant):
    world = World(two_boards(), variants={"can0/5": VARIANTS[variant]}).up()
    if variant != "standard":  # guarded: no heartbeat tells the state
        world.boards.board("can0/5").objects.set_number(0x1017, 0, 0)
        world.boards.board("can0/5").supervision.begin(world.now)
    world.stalled = True
    world.say(cia301.NMT, bytes([cia301.Command.STOP, 5]))
    world.run(1.0)
    assert world.boards.board("can0/5").state is State.STOPPED
    five, nine = asked(world)
    assert (five.code, nine.code) == ("board-stopped", "")
    assert five.text == (
        "board can0/5 is stopped, as after the end of an executor with on_loss: contract; it answers no SDO: start the"
        " executor, or reset the board: hyperbit board ARM.yaml can0/5 reset;"
        " only run can tell whether it can be booted"
    )


def test_a_board_that_is_heard_and_does_not_answer_is_not_asked_for_its_power():
    world = World(two_boards()).up()
    world.lost = lambda bus, frame: frame.id == 0x585
    five, _ = asked(world)
    assert (five.code, "board can0/5 is pre-operational, but does not answer" in five.text) == ("board-missing", True)


def test_the_heartbeat_of_an_executor_ends_the_check_at_once():
    world = World(two_boards())
    with session(world) as asking:
        world.say(cia301.HEARTBEAT + 0x7F, b"\x05")
        with pytest.raises(MasterHeard, match="can0"):
            check_bus(asking, world.wiring, world.timing)


def test_the_heartbeat_of_an_executor_is_heard_before_anything_is_sent():
    world = World(two_boards())
    world.after(0.5, lambda: world.say(cia301.HEARTBEAT + 0x7F, b"\x05"))
    world.frames()
    with pytest.raises(MasterHeard, match="can0"), session(world):
        raise AssertionError
    assert not any(cob_id & 0x780 == cia301.SDO_REQUEST for cob_id, _ in world.frames(sdo=True))


def test_silent_boards_are_asked_in_parallel():
    world = World([Channel(str(n), "can0", n, 0, 0) for n in range(1, 101)])
    for node in range(1, 101):
        world.fault("silence", f"can0/{node}")
    begun = world.now
    answers = asked(world)
    assert all(answer.code for answer in answers)
    assert "can0/1 neither booted nor answered" in answers[0].text
    assert {answer.code for answer in answers} == {"board-missing"}
    assert world.now - begun < 4.0


def test_a_lost_bus_is_told_once_and_before_its_boards():
    bus, good, lost = asked(World(two_buses()), lose="can1")
    assert (bus.board, bus.code, bus.text) == ("can1", "bus-down", "can1: it is down")
    assert (good.code, bool(lost.code)) == ("", True)
    assert "can1/5 does not answer: can1: it is down" in lost.text


@pytest.mark.parametrize("passive", [True, False])
def test_a_bus_that_takes_no_frame_is_to_blame_and_not_its_boards(passive):
    world = World()
    world.buses["can0"].stuck = True
    world.boards.board("can0/5").silent = True
    with session(world) as asking:
        if passive:
            asking.buses["can0"].events.append(BusChanged("can0", "passive", "", (128, 0)))
        bus, five = check_bus(asking, world.wiring, world.timing)
    assert bus.board == "can0"
    assert "check cable, termination, bit rate, and that a board on this bus has power" in bus.text
    assert ("error-passive" in bus.text) == passive
    assert five.text.startswith("board can0/5 does not answer: no")
    assert "check" not in five.text


def test_a_bus_that_cannot_be_opened_is_told():
    bus = BusWiring("can0", "socketcan", "no-such-interface")
    with pytest.raises(BusError, match="no-such-interface"), Session([CanBus(bus)]):
        raise AssertionError("it is open")


def test_the_loss_of_the_last_master_is_no_error():
    world = World(variants={"can0/5": VARIANTS["kept-loss"]}).up()
    world.run(1.0)
    world.stalled = True
    world.run(2.0)
    [five] = asked(world)
    assert not five.code
    assert "error register 11h (it has lost its last master" in five.text
