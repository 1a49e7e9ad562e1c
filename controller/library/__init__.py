"""The names of the package `hyperbit`; its own file is .package/hyperbit/__init__.py."""

from hyperbit.controller.design.merit import Merit
from hyperbit.controller.library.arm import Arm
from hyperbit.controller.library.calibration import Fitted, calibrate
from hyperbit.controller.library.density import Density, Reach
from hyperbit.controller.library.design import Design, Designs, Study, design, merit
from hyperbit.controller.library.errors import (
    ArmError,
    CalibrationError,
    ConfigurationError,
    Error,
    GoalError,
    LockError,
    ObstacleError,
    PathError,
    PictureError,
    StudyError,
    ThreadError,
)
from hyperbit.controller.library.goals import Goal, read_goals
from hyperbit.controller.library.loading import load
from hyperbit.controller.library.many import map
from hyperbit.controller.library.modules import Module, group, platform, prismatic, revolute, transforms, vgt
from hyperbit.controller.library.obstacles import Box, Disc, HalfPlane, HalfSpace, Obstacle, Sphere
from hyperbit.controller.library.path import Path
from hyperbit.controller.library.plot import animate, plot
from hyperbit.controller.library.solver import Solver
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
    "Design",
    "Designs",
    "Disc",
    "Error",
    "Fitted",
    "Goal",
    "GoalError",
    "HalfPlane",
    "HalfSpace",
    "LockError",
    "Merit",
    "Method",
    "Module",
    "Obstacle",
    "ObstacleError",
    "Path",
    "PathError",
    "PictureError",
    "Reach",
    "Solution",
    "Solver",
    "Sphere",
    "Study",
    "StudyError",
    "ThreadError",
    "animate",
    "calibrate",
    "design",
    "group",
    "load",
    "map",
    "merit",
    "platform",
    "plot",
    "prismatic",
    "read_goals",
    "revolute",
    "transforms",
    "vgt",
]
