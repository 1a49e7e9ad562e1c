"""Inverse kinematics of arms made of many two-state actuators, as a Python library.

    import hyperbit as hb

    arm = hb.load("planar16.yaml")
    ik = hb.Solver(arm, obstacles=[hb.Disc((1.2, 2.0), 0.3)])
    solution = ik.solve(hb.Goal((0.55, 2.9), tolerance=2e-3), start=arm.home)
    print(solution.configuration, solution.switches, solution.certificate)
    path = ik.follow([hb.Goal((0.4, 2.9)), hb.Goal((0.5, 2.8))], start=solution)
    hb.plot(arm, path).savefig("path.png")

Units: lengths in the unit of the arm's description, angles in radians counter-clockwise, times in seconds. A
configuration is one integer for each module, base first, shape (B,). Every error is a subclass of `hyperbit.Error`.

Limits: `certificate` states how much a search has proven within its deadline. Densities count configurations in pixels
and are approximate. Between goals, the stages in which actuators switch are checked for collisions. A solver is not
thread-safe.
"""

from hyperbit.controller.library.arm import Arm, load
from hyperbit.controller.library.calibration import Fitted, calibrate
from hyperbit.controller.library.density import Density
from hyperbit.controller.library.errors import (
    ArmError,
    CalibrationError,
    ConfigurationError,
    Error,
    GoalError,
    LockError,
    ObstacleError,
    PathError,
    StudyError,
)
from hyperbit.controller.library.goals import Goal
from hyperbit.controller.library.many import map
from hyperbit.controller.library.modules import Module, platform, prismatic, revolute, transforms, vgt
from hyperbit.controller.library.obstacles import Box, Disc, HalfPlane, HalfSpace, Obstacle, Sphere
from hyperbit.controller.library.plot import plot
from hyperbit.controller.library.solver import Path, Solver
from hyperbit.controller.search.method import METHODS, Method
from hyperbit.controller.search.solution import Certificate, Solution

__all__ = [
    "METHODS",
    "Arm",
    "ArmError",
    "Box",
    "CalibrationError",
    "Certificate",
    "ConfigurationError",
    "Density",
    "Disc",
    "Error",
    "Fitted",
    "Goal",
    "GoalError",
    "HalfPlane",
    "HalfSpace",
    "LockError",
    "Method",
    "Module",
    "Obstacle",
    "ObstacleError",
    "Path",
    "PathError",
    "Solution",
    "Solver",
    "Sphere",
    "StudyError",
    "calibrate",
    "load",
    "map",
    "platform",
    "plot",
    "prismatic",
    "revolute",
    "transforms",
    "vgt",
]
