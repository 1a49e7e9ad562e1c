"""Travel times measured by the executor on simulated boards and a simulated clock."""

from __future__ import annotations

from typing import Any

import pytest

from hyperbit.controller.executor.arm.kinds import Ends
from hyperbit.controller.executor.arm.switch_journal import SwitchJournal
from hyperbit.controller.executor.core.core import Executor
from hyperbit.controller.executor.core.events import ExecutorTick, FromClient, SendFrame, ToClient
from hyperbit.controller.executor.motion.readings import TravelTimes
from hyperbit.controller.executor.process.embedded_boards import EmbeddedBoards
from hyperbit.controller.program import VERSION, Alive, Ended, Hello, Program, Snapshot, Stage, Travel, pack
from hyperbit.drivers.simulation.buses import LEAST_PULSE
from tests.executor.rig import PLANNER, SIZE, small_arm
from tests.executor.world import STEP, World, ready

BOTH = {"input_contracted": True}


def world(contract: float, extend: float, **channel: object) -> World:
    """Boards whose actuators take these times, half of the greatest [s]."""
    return ready(channel={**BOTH, **channel, "travel": (2 * contract, 2 * extend)})


def travels(made: World) -> list[tuple[int, int, float]]:
    assert made.last(Ended).status == "done"
    return [(t.actuator, t.state, t.seconds) for t in made.last(Ended).travels]


@pytest.mark.parametrize(("contract", "extend"), [(0.04, 0.12), (0.12, 0.04), (0.075, 0.09)])
@pytest.mark.parametrize("channel", [{}, {"output_off": True}, {"output_off": True, "pulse": 0.05}])
def test_each_way_of_each_actuator_is_measured(contract: float, extend: float, channel: dict[str, object]) -> None:
    made = world(contract, extend, **channel)
    for k in range(6):
        for state, seconds in ((1, extend), (0, contract)):
            made.run(2 * k + 2 - state, state << k)
            made.go(0.5)
            [(actuator, end, measured)] = travels(made)
            assert (actuator, end) == (k, state)
            valve = LEAST_PULSE if "output_off" in channel else 0.0
            assert measured == pytest.approx(seconds + valve, rel=0.1)


def test_the_travel_time_of_a_slow_actuator_is_measured() -> None:
    made = world(0.05, 0.05)
    made.fault("slow", "1.left", 1.6)
    made.run(1, 0b1)
    made.go(0.5)
    assert travels(made) == [(0, 1, pytest.approx(0.08, rel=0.1))]


def test_frames_that_are_read_late_give_the_same_times() -> None:
    made = world(0.04, 0.04)
    made.run(1, 0b1)
    made.go(STEP)
    made.executor.stall(0.07)
    made.go(0.5)
    assert travels(made) == [(0, 1, pytest.approx(0.04, rel=0.1))]


@pytest.mark.parametrize("lateness", [0.0, 0.017, 0.15])
def test_boards_inside_an_executor_that_stalls_give_their_own_times(lateness: float) -> None:
    now = 50.0
    arm = small_arm(channel={**BOTH, "travel": (0.16, 0.24)})
    core, boards = Executor(arm, SwitchJournal(SIZE), instance=1), EmbeddedBoards(arm.wiring, arm.timing)
    heard: list[Any] = []

    def do(event: Any) -> None:
        for action in core.step(event, now):
            if isinstance(action, SendFrame):
                boards.send_frame(action.bus, action.frame, now)
            elif isinstance(action, ToClient):
                heard.append(action.message)

    do(FromClient(PLANNER, Hello(VERSION, "planner", "small")))
    for k in range(1000):
        now += 0.003 if k % 10 else 0.003 + lateness
        for event in boards.poll(now):
            do(event)
        do(FromClient(PLANNER, Alive()))
        do(ExecutorTick())
        snapshot = next(message for message in reversed(heard) if isinstance(message, Snapshot))
        if k == 500:
            assert snapshot.mode == "ready", snapshot.reason
            stages = (Stage(pack(1, SIZE), at=0.0, mark=0),)
            do(FromClient(PLANNER, Program(1, snapshot.epoch, snapshot.outputs, 0.0, stages, True, False, "goal")))
    [ended] = [message for message in heard if isinstance(message, Ended)]
    assert [(t.actuator, t.state, t.seconds) for t in ended.travels] == [(0, 1, pytest.approx(0.12, rel=0.1))]


def test_a_way_to_an_end_without_an_end_stop_is_not_measured() -> None:
    made = ready(channel={"travel": (0.08, 0.08)})
    made.run(1, 0b1)
    made.go(0.5)
    assert len(travels(made)) == 1
    made.run(2, 0)
    made.go(0.5)
    assert travels(made) == []


@pytest.mark.parametrize(("begun", "ended"), [(None, 2.0), (1.0, None)])
def test_a_way_whose_frames_tell_no_time_is_not_measured(begun: float | None, ended: float | None) -> None:
    times = TravelTimes()
    times.begin(0b1, 0b1, Ends(0, 0b1), begun)
    assert times.drain_arrived(Ends(0b1, 0), ended) == []
    assert not any(times.travelling)


def test_a_way_that_was_called_back_is_measured_anew() -> None:
    times = TravelTimes()
    times.begin(0b1, 0b1, Ends(0, 0b1), 1.0)
    times.begin(0b1, 0b0, Ends(0, 0), 1.1)
    assert times.drain_arrived(Ends(0, 0), 1.15) == []
    assert times.drain_arrived(Ends(0, 0b1), 1.2) == [Travel(0, 0, pytest.approx(0.1))]
    assert not any(times.travelling)
