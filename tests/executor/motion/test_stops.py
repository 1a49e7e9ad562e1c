"""Ends of motion at each moment of a commit, on simulated boards with frames that leave late."""

from __future__ import annotations

import itertools

import pytest

from hyperbit.controller.host.process import Quit
from hyperbit.controller.program import Accepted, Answer, Cancel, Ended, Reset, Stop
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wiring import Interlock
from hyperbit.drivers.simulation.variants import VARIANTS
from tests.executor.rig import SIZE, STEP, A, World, ready_world
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
REQUESTS = {"stop": Stop(9), "cancel": Cancel(9, None, "")}
OTHERS = ("fault", "interlock", "planner gone", "planner silent", "end")
# Each moment with each kind of boards, and with a request and another cause in turn.
MOMENTS = list(itertools.product(BOARDS, range(FRAMES)))
CASES = [
    (cause, *moment)
    for k, moment in enumerate(MOMENTS)
    for cause in (list(REQUESTS)[(k + k // FRAMES) % 2], OTHERS[k % len(OTHERS)])
]


def slow_down(world: World) -> None:
    bus = world.buses["can0"]
    bus.bitrate, bus.log = SLOW, []


def committing(boards: str, sent: int) -> tuple[World, int]:
    """Returns a world at A in the middle of its commit of C, after `sent` frames, and its switches before."""
    world = ready_world(interlocks=(DOOR,), **BOARDS[boards])
    world.run(A)
    world.go(0.3)
    assert (world.last(Ended).status, world.driven) == ("done", A), world.logged
    before = sum(world.boards.switches())
    slow_down(world)
    world.run(C)

    def left() -> int:
        log = world.buses["can0"].log or ()
        return sum(frame.id == cia301.SYNC or frame.id & 0x780 in RPDOS for frame in log)

    world.agenda.until(lambda: left() >= sent or not world.core.master.switching.under_way)
    world.go(WAKE_UP)  # the executor gets the last echo
    return world, before


def end(world: World, cause: str) -> None:
    match cause:
        case "stop" | "cancel":
            world.send(REQUESTS[cause])
        case "fault" | "interlock":
            world.fault(*(("error", "can0/1", "2320") if cause == "fault" else ("open", "door")))
            world.agenda.until(lambda: world.mode == "fault", 0.1)
        case "planner gone":
            world.leave()
        case "planner silent":
            world.core.lose_planner("the planner is silent")
        case "end":
            world.do(Quit())


def commanded(world: World, boards: str) -> int:
    """Number of switches; a pulsed actuator follows its coil late, so there the executor's count is taken."""
    return sum(world.journal.counts) if boards == "pulses" else sum(world.boards.switches())


@pytest.mark.parametrize(("cause", "boards", "sent"), CASES)
def test_nothing_switches_after_the_answer_and_frames_that_wait_are_given_up(
    cause: str, boards: str, sent: int
) -> None:
    world, before = committing(boards, sent)
    asked, given = world.now, commanded(world, boards)
    end(world, cause)
    stopped = {"stop": "stopped", "fault": "fault", "interlock": "fault"}.get(cause, "ready")
    assert world.mode == stopped, "at once"
    syncs = len(world.syncs)
    begun = next(at for at, _, message in world.heard if isinstance(message, Accepted) and message.program == 2)
    handed_out = world.syncs[-1] >= begun
    answered: list[tuple[int, set[int]]] = []  # switches and coils that are on, from the answer on

    def watch() -> None:
        if world.of(Answer):
            on = {2 * k + side for k, pair in enumerate(world.boards.coils()) for side in (0, 1) if pair[side]}
            answered.append((commanded(world, boards), on))

    world.go(0.3, watch)
    if not world.has_planner:
        world.connect()
    ended = next(ended for ended in world.of(Ended) if ended.program == 2)
    if cause in REQUESTS:
        ((at, answer),) = [(at, said) for at, _, said in world.heard if isinstance(said, Answer)]
        assert at - asked <= world.arm.timing.heartbeat_timeout / 2
        assert {count for count, _ in answered} == {answered[0][0]}
        assert all(on <= answered[0][1] for _, on in answered), "a pulse may end, and none may begin"
        told = {0: "", 3: "; 3 switches were under way", 6: "; 6 switches were under way"}[answered[0][0] - given]
        assert (
            answer.message == {"stop": f"stopped{told}; the arm holds until reset", "cancel": f"canceled{told}"}[cause]
        )
        assert ended.switches == answered[0][0] - before
    else:
        assert ended.status == "aborted"
        assert ended.switches == sum(world.boards.switches()) - before
        if "no" not in boards and "without" not in boards:
            assert ended.switches == (6 if handed_out else 0)
        if boards != "pulses":  # the end of a pulse needs a SYNC, which moves nothing
            assert len(world.syncs) == syncs
    assert world.ended == (cause == "end")
    if not world.ended:
        finish(world)


def finish(world: World) -> None:
    """A later goal works, and each switch was counted once."""
    world.buses["can0"].bitrate = FAST
    world.fault("close", "door")
    world.fault("error_over", "can0/1", "2320")
    world.go(1.0)
    if world.mode in ("fault", "stopped"):
        world.send(Reset(99, world.epoch))
    world.go(1.5)
    assert world.mode == "ready", world.logged
    if world.arm.wiring.channels[0].pulse is None:
        assert world.driven == world.states
    goal = world.states ^ 0b100001
    world.run(goal)
    world.go(0.6)
    assert (world.last(Ended).status, world.driven) == ("done", goal), world.logged
    assert world.journal.counts == world.boards.switches()


@pytest.mark.parametrize("late", range(0, 40, 6))
def test_a_pulse_that_ends_moves_nothing_of_what_boards_have_latched(late: int) -> None:
    """The SYNC that ends a pulse comes while boards still hold frames of a commit that was given up."""
    world = ready_world(interlocks=(DOOR,), **BOARDS["pulses"])
    world.run(A)
    world.go(0.6)
    world.run(A ^ 1, A ^ 1 ^ C, step=late * STEP)
    world.go(late * STEP)
    slow_down(world)
    world.send(Stop(9))
    world.go(0.1)
    driven = world.driven
    world.go(0.5)
    assert world.driven == driven
    assert world.boards.coils() == [(0, 0)] * SIZE
    finish(world)
