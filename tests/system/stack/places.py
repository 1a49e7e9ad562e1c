"""Positions that the paper's arm reaches, and the states of its tip and its actuators."""

import numpy as np

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.manipulator.notation import parse_configuration
from hyperbit.drivers.simulation.simulation import Simulation
from tests.system.stack.observer import Observer

LEFT, MIDDLE, RIGHT = (0.4, 2.9), (0.55, 2.9), (3.0, 0.7)
HOUR = 3600.0


def tip(boards: Simulation, arm: Arm) -> np.ndarray:
    """The physical position of the tip."""
    positions = boards.positions()
    assert np.isin(positions, (0, 1)).all(), "an actuator is between its ends"
    manipulator = arm.manipulator
    return manipulator.tip(manipulator.configuration(positions.astype(np.uint8)))[: manipulator.dimension, 3]


def states_at(client: Observer, arm: Arm, goal: tuple[float, ...]) -> np.ndarray:
    """The actuator states (A,) at the end of a goal's plan."""
    planned = client.ask("plan", waypoints=[{"position": goal}])["waypoints"][0]["configuration"]
    return arm.manipulator.actuator_states(parse_configuration(arm.manipulator, planned))


def first_to_switch(client: Observer, arm: Arm, goal: tuple[float, ...]) -> tuple[str, int]:
    wanted, now = states_at(client, arm, goal), client.wait_now("ready")["measured"]
    k = int(np.flatnonzero(wanted != now)[0])
    return arm.manipulator.actuators[k], now[k]


def other_place(client: Observer, arm: Arm) -> tuple[float, float]:
    """A position that the arm can reach only by a switch."""
    now = client.state["measured"]
    return next(goal for goal in (RIGHT, MIDDLE) if (states_at(client, arm, goal) != now).any())
