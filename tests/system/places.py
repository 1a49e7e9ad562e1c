"""Places that the arm of the paper reaches, and where its tip and its actuators are."""

import numpy as np

from controller.config import Arm
from controller.manipulator.notation import parse_configuration
from drivers.simulation.simulation import Simulation
from tests.system.observer import Observer

LEFT, MIDDLE, RIGHT = (0.4, 2.9), (0.55, 2.9), (3.0, 0.7)
HOUR = 3600.0


def tip(boards: Simulation, arm: Arm) -> np.ndarray:
    """Where the tip physically is."""
    positions = boards.positions()
    assert np.isin(positions, (0, 1)).all(), "an actuator is between its ends"
    manipulator = arm.manipulator
    return manipulator.tip(manipulator.configuration(positions.astype(np.uint8)))[: manipulator.dimension, 3]


def states_at(client: Observer, arm: Arm, goal: tuple[float, ...]) -> np.ndarray:
    """Actuator states (A,) that a goal is planned to end in."""
    planned = client.ask("plan", waypoints=[{"position": goal}])["waypoints"][0]["configuration"]
    return arm.manipulator.actuator_states(parse_configuration(arm.manipulator, planned))


def first_to_switch(client: Observer, arm: Arm, goal: tuple[float, ...]) -> tuple[str, int]:
    """The first actuator that a goal switches, and the state it is in now."""
    wanted, now = states_at(client, arm, goal), client.wait_now("ready")["measured"]
    k = int(np.flatnonzero(wanted != now)[0])
    return arm.manipulator.actuators[k], now[k]


def other_place(client: Observer, arm: Arm) -> tuple[float, float]:
    """A place that the arm, at rest, must switch actuators to get to."""
    now = client.state["measured"]
    return next(goal for goal in (RIGHT, MIDDLE) if (states_at(client, arm, goal) != now).any())
