"""The bus check on simulated boards; tests/drivers/variants has its verdict on each variant."""

from __future__ import annotations

import pytest

from hyperbit.drivers.canopen.faults import BusError
from hyperbit.drivers.canopen.tools.bus_check import check_bus
from hyperbit.drivers.canopen.tools.session import MasterHeard, Session
from hyperbit.drivers.canopen.wire.bus import CanBus
from hyperbit.drivers.canopen.wire.cia301 import SDO_REQUEST, Command, State
from hyperbit.drivers.canopen.wire.events import BusChanged
from hyperbit.drivers.canopen.wiring import BusWiring
from hyperbit.drivers.simulation.variants import VARIANTS
from tests.drivers.rig import World, each_node, two_boards, two_buses
from tests.drivers.sessions import SessionInWorld, checked

BEAT = 0x77F, b"\x05"


def test_every_board_says_what_it_is() -> None:
    world = World(two_boards())
    world.board("can0/9").objects.set_number(0x1000, 0, 0x00020191)
    world.objects.set_number(0x1001, 0, 0x81)
    five, nine = checked(world)
    assert (five.board, five.code) == ("can0/5", "board-error")
    assert "error register 1001h sub 0 is 81h; 00h is needed" in five.text
    assert (nine.board, nine.code) == ("can0/9", "")
    assert nine.text.startswith("can be booted: device type 00020191h, error register 00h; to be written: 1016h sub 1")
    assert "1000h sub 0 is 00020191h, without the bit of digital inputs" in nine.text
    assert not any(cob_id < 0x580 for cob_id, _ in world.frames())


def test_a_lost_answer_leaves_the_error_mode_of_a_running_arm() -> None:
    world = World(two_boards(), on_loss="hold").up()
    world.lost = lambda bus, frame: frame.id == 0x585 and frame.data[0] == 0x60
    world.stalled = True
    [told, _] = checked(world, on_loss="contract")
    assert told.code == "sdo-unanswered"
    assert [world.objects.number(0x6206, 1), world.objects.number(0x1029, 1)] == [0xFE, 0]


@pytest.mark.parametrize("variant", ["standard", "one-supervision"])
def test_a_stopped_board_is_said_to_be_stopped(variant: str) -> None:
    world = World(two_boards(), variant=VARIANTS[variant]).up()
    if variant != "standard":  # guarded: no heartbeat tells the state
        world.objects.set_number(0x1017, 0, 0)
        world.board().supervision.begin(world.now)
    world.stalled = True
    world.nmt(Command.STOP)
    world.run(1.0)
    assert world.board().state is State.STOPPED
    five, nine = checked(world)
    assert (five.code, nine.code) == ("board-stopped", "")
    assert five.text == (
        "board can0/5 is stopped, as after the end of an executor with on_loss: contract; it answers no SDO: start the"
        " executor, or reset the board: hyperbit board ARM.yaml can0/5 reset;"
        " only run can tell whether it can be booted"
    )


def test_a_board_that_is_heard_and_does_not_answer_is_not_asked_for_its_power() -> None:
    world = World(two_boards()).up()
    world.lose(0x585)
    five, _ = checked(world)
    assert (five.code, "board can0/5 is pre-operational, but does not answer" in five.text) == ("board-missing", True)


@pytest.mark.parametrize("before", [True, False], ids=["before anything is sent", "during the check"])
def test_the_heartbeat_of_an_executor_ends_the_check_at_once(before: bool) -> None:
    world = World(two_boards())
    world.frames()
    if before:
        world.after(0.5, lambda: world.say(*BEAT))
    else:
        world.deaf = lambda frame: world.say(*BEAT) is not None  # at the first request
    with pytest.raises(MasterHeard, match="can0"):
        checked(world)
    asked = [cob_id for cob_id, _ in world.frames(sdo=True) if cob_id & 0x780 == SDO_REQUEST]
    assert len(asked) <= (0 if before else 2)


def test_silent_boards_are_asked_in_parallel() -> None:
    world = World(each_node(100))
    for node in range(1, 101):
        world.fault("silence", f"can0/{node}")
    begun = world.now
    answers = checked(world)
    assert "can0/1 neither booted nor answered" in answers[0].text
    assert {answer.code for answer in answers} == {"board-missing"}
    assert world.now - begun < 4.0


def test_a_lost_bus_is_told_once_and_before_its_boards() -> None:
    bus, good, lost = checked(World(two_buses()), lose="can1")
    assert (bus.board, bus.code, bus.text) == ("can1", "bus-down", "can1: it is down")
    assert (good.code, bool(lost.code)) == ("", True)
    assert "can1/5 does not answer: can1: it is down" in lost.text


@pytest.mark.parametrize("passive", [True, False])
def test_a_bus_that_takes_no_frame_is_to_blame_and_not_its_boards(passive: bool) -> None:
    world = World()
    world.buses["can0"].stuck = True
    world.fault("silence", "can0/5")
    with SessionInWorld(world) as asking:
        if passive:
            asking.buses["can0"].events.append(BusChanged("can0", "passive", "", (128, 0)))
        bus, five = check_bus(asking, world.wiring, world.timing)
    assert bus.board == "can0"
    assert "check cable, termination, bit rate, and that a board on this bus has power" in bus.text
    assert ("error-passive" in bus.text) == passive
    assert five.text.startswith("board can0/5 does not answer: no")
    assert "check" not in five.text


def test_a_bus_that_cannot_be_opened_is_told() -> None:
    bus = BusWiring("can0", "socketcan", "no-such-interface")
    with pytest.raises(BusError, match="no-such-interface"), Session([CanBus(bus)]):
        raise AssertionError("it is open")


def test_the_loss_of_the_last_master_is_no_error() -> None:
    world = World(variant="kept-loss").up()
    world.run(1.0)
    world.stalled = True
    world.run(2.0)
    [five] = checked(world)
    assert not five.code
    assert "error register 11h (it has lost its last master" in five.text
