"""The arm of the paper and its densities, for every room's tests."""

from pathlib import Path

import pytest
from hypothesis import settings

from controller.config import Arm, load
from controller.manipulator.manipulator import Manipulator
from controller.search.solver import Solver
from controller.workspace.cache import load_or_map
from controller.workspace.densities import Densities

# The same examples on every run, and no deadline, which a busy machine would miss.
settings.register_profile("hyperbit", derandomize=True, deadline=None)
settings.load_profile("hyperbit")

PAPER_ARM = Path(__file__).parents[1] / "deploy" / "planar16.yaml"


@pytest.fixture(scope="session")
def arm() -> Arm:
    return load(PAPER_ARM)


@pytest.fixture(scope="session")
def manipulator(arm: Arm) -> Manipulator:
    return arm.manipulator


@pytest.fixture(scope="session")
def densities(arm: Arm, tmp_path_factory: pytest.TempPathFactory) -> Densities:
    return load_or_map(arm.manipulator, 0.02, arm.level_pixels, tmp_path_factory.mktemp("densities"))


@pytest.fixture(scope="session")
def solver(manipulator: Manipulator, densities: Densities) -> Solver:
    return Solver(manipulator, densities)
