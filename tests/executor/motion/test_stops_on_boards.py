"""Stops at each moment of a commit, with the real CANopen master, simulated boards, and frames that leave late."""

from __future__ import annotations

import pytest

from hyperbit.controller.host.process import Quit
from hyperbit.controller.program import Accepted, Answer, Cancel, Ended, Reset, Snapshot, Stop, unpack
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wiring import Interlock
from hyperbit.drivers.simulation.variants import VARIANTS
from tests.executor.rig import SIZE
from tests.executor.world import STEP, A, World, ready
from tests.simulation.buses.bus_model import RPDOS
from tests.simulation.executor.process import WAKE_UP

C = 0b111000
FAST, SLOW = 1_000_000, 10_000  # [bit/s]; at the slow rate a frame takes 6 to 14 ms
DOOR = Interlock("door", "can0", 9, 0)
BOARDS = {
    "SYNC": {},
    "no SYNC": {"variants": {"can0/1": VARIANTS["no-sync"], "can0/2": VARIANTS["no-sync"]}},
    "one without SYNC": {"variants": {"can0/2": VARIANTS["no-sync"]}},
    "pulses": {"channel": {"output_off": True, "pulse": 0.05}},
}
FRAMES = 4  # more than any commit here has: two RPDOs and SYNC


def commanded(world: World, boards: str) -> int:
    """Number of switches; a pulsed actuator follows its coil late, so there the executor's count is taken."""
    return sum(world.journal.counts) if boards == "pulses" else sum(world.boards.switches())


def slow_down(world: World) -> None:
    bus = world.buses["can0"]
    bus.bitrate, bus.log = SLOW, []


def frames_left(world: World) -> int:
    """Number of RPDOs and SYNCs that have left the slow bus."""
    return sum(frame.id == cia301.SYNC or frame.id & 0x780 in RPDOS for frame in world.buses["can0"].log or ())


def committing(boards: str, sent: int) -> tuple[World, int]:
    """Returns a world at A in the middle of its commit of C, after `sent` frames, and its switches before."""
    world = ready(interlocks=(DOOR,), **BOARDS[boards])
    world.run(1, A)
    world.go(0.6)
    assert (world.last(Ended).status, world.driven) == ("done", A), world.logged
    before = sum(world.boards.switches())
    slow_down(world)
    world.run(2, C)
    world.agenda.until(lambda: frames_left(world) >= sent or not world.core.master.committing)
    world.go(WAKE_UP)  # the executor gets the last echo
    return world, before


def finish(world: World) -> None:
    """A later goal works, and each switch was counted once."""
    world.buses["can0"].bitrate = FAST
    world.go(1.0)
    if not world.has_planner:
        world.connect()
    world.fault("close", "door")
    world.fault("error_over", "can0/1", "2320")
    world.go(1.0)
    if world.mode in ("fault", "stopped"):
        world.send(Reset(99, world.epoch))
    world.go(2.0)
    assert world.mode == "ready", world.logged
    stops = world.driven
    assert stops == unpack(world.last(Snapshot).outputs)
    world.run(3, stops ^ 0b100001)
    world.go(0.6)
    assert (world.last(Ended).status, world.driven) == ("done", stops ^ 0b100001), world.logged
    assert world.journal.counts == world.boards.switches()


REQUESTS = {"stop": Stop(9), "cancel": Cancel(9, None, "")}


@pytest.mark.parametrize("sent", range(FRAMES))
@pytest.mark.parametrize("boards", BOARDS)
@pytest.mark.parametrize("request_", REQUESTS)
def test_nothing_switches_after_the_answer(request_: str, boards: str, sent: int) -> None:
    world, before = committing(boards, sent)
    asked, given = world.now, commanded(world, boards)
    world.send(REQUESTS[request_])
    assert world.mode == {"stop": "stopped", "cancel": "ready"}[request_], "at once"
    answered: list[int] = []
    coils: list[set[tuple[int, int]]] = []

    def watch() -> None:
        if any(isinstance(message, Answer) and world.now > at for at, message in world.heard):
            answered.append(commanded(world, boards))
            coils.append({(k, side) for k, pair in enumerate(world.boards.coils()) for side in (0, 1) if pair[side]})

    world.go(0.5, watch)
    ((at, answer),) = [(at, message) for at, message in world.heard if isinstance(message, Answer)]
    assert set(answered) == {answered[0]}
    assert all(later <= coils[0] for later in coils), "a pulse may end, and none may begin"
    assert at - asked <= world.core._arm.timing.heartbeat_timeout / 2
    told = answered[0] - given
    expected = {0: "", 3: "; 3 switches were under way", 6: "; 6 switches were under way"}[told]
    holds = "; the arm holds until reset" if request_ == "stop" else ""
    assert answer.message == f"{'stopped' if request_ == 'stop' else 'canceled'}{expected}{holds}"
    assert world.of(Ended)[1].switches == answered[0] - before
    finish(world)


@pytest.mark.parametrize("sent", range(FRAMES))
@pytest.mark.parametrize("boards", BOARDS)
@pytest.mark.parametrize("cause", ["fault", "interlock", "planner gone", "planner silent", "end"])
def test_an_end_without_a_request_gives_up_the_frames_that_wait(cause: str, boards: str, sent: int) -> None:
    world, before = committing(boards, sent)
    begun = next(at for at, message in world.heard if isinstance(message, Accepted) and message.program == 2)
    match cause:
        case "fault":
            world.fault("error", "can0/1", "2320")
            world.agenda.until(lambda: world.mode == "fault", 0.1)
        case "interlock":
            world.fault("open", "door")
            world.agenda.until(lambda: world.mode == "fault", 0.1)
        case "planner gone":
            world.leave()
        case "planner silent":
            world.core.lose_planner("the planner is silent")
        case "end":
            world.post(Quit())
    assert world.mode == ("fault" if cause in ("fault", "interlock") else "ready"), "at once"
    syncs = len(world.syncs)
    handed_out = world.syncs[-1] >= begun
    world.go(0.5)
    if not world.has_planner:
        world.connect()
    ended = next(ended for ended in world.of(Ended) if ended.program == 2)
    assert ended.status == "aborted"
    if boards in ("SYNC", "pulses"):
        moved = 6 if handed_out else 0
        assert (sum(world.boards.switches()) - before, ended.switches) == (moved, moved)
    else:
        assert ended.switches == sum(world.boards.switches()) - before
    if boards != "pulses":  # the end of a pulse needs a SYNC, which moves nothing
        assert len(world.syncs) == syncs
    if cause == "end":
        assert world.ended
    else:
        finish(world)


@pytest.mark.parametrize("late", [k * STEP for k in range(0, 40, 3)])
def test_a_pulse_that_ends_moves_nothing_of_what_boards_have_latched(late: float) -> None:
    """The SYNC that ends a pulse comes while boards still hold frames of a commit that was given up."""
    world = ready(**BOARDS["pulses"])
    world.run(1, A)
    world.go(0.6)
    world.run(2, A ^ 1, A ^ 1 ^ C, step=late)
    world.go(late)
    slow_down(world)
    world.send(Stop(9))
    world.go(0.1)
    driven = world.driven
    world.go(0.5)
    assert world.driven == driven
    assert world.boards.coils() == [(0, 0)] * SIZE
    finish_pulses(world)


def finish_pulses(world: World) -> None:
    """A later goal works, and each switch was counted once."""
    world.buses["can0"].bitrate = FAST
    world.go(1.0)
    world.send(Reset(99, world.epoch))
    world.go(2.0)
    world.run(3, unpack(world.last(Snapshot).outputs) ^ 0b100001)
    world.go(0.6)
    assert world.last(Ended).status == "done", world.logged
    assert world.journal.counts == world.boards.switches()
