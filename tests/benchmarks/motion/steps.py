"""Processor time of two steps of planning: one setpoint of a moving goal, and the stages of one transition.

python -m tests.benchmarks.motion.steps [--json PATH]

Each time is the least mean of several batches, as other processes share the machine.
"""

import time
from collections.abc import Callable

import numpy as np

from hyperbit.controller.arm.arm import load
from hyperbit.controller.motion.stages.stages import order_stages
from hyperbit.controller.motion.tracking.tracking import GoalTracker
from tests.benchmarks.harness import PAPER_ARM, CommandLine, report

BATCHES, RUNS = 20, 50
DELAY = 0.06  # from a decision to the tip's arrival [s]
SWITCHES, AT_ONCE = 8, 3


def least(step: Callable[[int], object]) -> float:
    """Returns the least mean processor time [ms] of a step over the batches; a step takes its number."""
    times = []
    for batch in range(BATCHES):
        began = time.thread_time()
        for k in range(RUNS):
            step(RUNS * batch + k)
        times.append((time.thread_time() - began) / RUNS)
    return round(1e3 * min(times), 4)


def setpoint() -> float:
    """Returns the time [ms] that the tracker takes for one setpoint in space at 200 Hz."""
    tracker = GoalTracker(3)

    def step(k: int) -> None:
        now = 1_800_000_000.0 + 0.005 * k
        tracker.measure((1.0, 2.0, 3.0), now, now)
        tracker.next_target(now, DELAY, (0, 0, 0), 0.01)

    return least(step)


def stages() -> float:
    """Returns the time [ms] to order SWITCHES switches of the paper's arm into stages of at most AT_ONCE."""
    manipulator, rng = load(PAPER_ARM).manipulator, np.random.default_rng(0)
    pairs = []
    for _ in range(RUNS):
        start = rng.integers(0, manipulator.states)
        states = manipulator.actuator_states(start)
        states[rng.choice(len(states), SWITCHES, replace=False)] ^= 1
        pairs.append((start, manipulator.configuration(states)))
    order_stages(manipulator, *pairs[0], AT_ONCE)
    return least(lambda k: order_stages(manipulator, *pairs[k % RUNS], AT_ONCE))


if __name__ == "__main__":
    options = CommandLine(__doc__).parse()
    report({"setpoint [ms]": setpoint(), f"stages of {SWITCHES} switches [ms]": stages()}, {}, options.json)
