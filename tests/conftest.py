"""The arm of the paper and its densities, for every room's tests."""

import gc
import importlib
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, settings

from hyperbit.controller.arm.arm import Arm, load
from hyperbit.controller.host.kernel import kernels
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.search.solver import Solver
from hyperbit.controller.workspace.cache import load_or_map
from hyperbit.controller.workspace.densities import Densities
from tests.shared import shared_folder
from tests.waiting import SLOWNESS

# The same examples on every run, and no limit of time, which a busy machine would miss.
settings.register_profile("hyperbit", derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("hyperbit")

# A shell without job control starts what runs in the background with SIGINT ignored, and each child inherits that.
signal.signal(signal.SIGINT, signal.default_int_handler)

# The program imports these late; the processes of the tests share them.
LATE = ("scipy.optimize", "matplotlib.backends.backend_agg", "mpl_toolkits.mplot3d", "optuna")
# What `make long-test` runs, and `make test` does not: each of these files takes 5 to 50 s of processor time.
LONG = (
    "calibration/test_calibration.py",
    "commands/test_commission_pages.py",
    "commands/test_first_arm.py",
    "commands/test_study.py",
    "deploy/test_wheel.py",
    "design/test_workers.py",
    "examples",
    "library/test_notebooks.py",
    "recorder/test_kills.py",
    "recorder/test_regression.py",
    "studies",
    "system/faults/test_kills.py",
)
BUSES = ("virtual", "socketcan")
pytest_plugins = ["tests.forks"]
PAPER_ARM = Path(__file__).parents[1] / "deploy" / "planar16.yaml"


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--bus", choices=BUSES, help="the only bus for tests that run on several")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    long = [Path(__file__).parent / name for name in LONG]
    for item in items:
        if any(item.path.is_relative_to(path) for path in long):
            item.add_marker("long")


def pytest_collection_finish(session: pytest.Session) -> None:
    """Keeps what has been imported and collected out of garbage collections: they took a twentieth of the time.

    All processes of the tests share the loaded kernels, a folder, and the process that forks commands.
    """
    if session.config.option.forks:
        for kernel in kernels:
            kernel.load()
        for name in LATE:
            importlib.import_module(name)
    gc.freeze()
    gc.set_threshold(20_000, 20, 20)
    shared_folder()
    if session.config.option.forks and (processes := sys.modules.get("tests.system.stack.processes")):
        processes.commands()


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Runs what opens a bus on each kind of bus, or on those that its mark names."""
    if "bus" in metafunc.fixturenames:
        only = metafunc.config.getoption("bus")
        buses = [bus for bus in buses_of(metafunc.definition) if only in (None, bus)]
        metafunc.parametrize("bus", buses, indirect=True)


def buses_of(test: pytest.Item) -> tuple[str, ...]:
    """Returns the kinds of bus that a test runs on: those of its mark, else all."""
    mark = test.get_closest_marker("buses")
    return mark.args if mark else BUSES


@pytest.fixture(scope="session")
def arm_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The arm of the paper; where the machine is slow, so are its actuators, and its boards are patient, and fewer."""
    settings = yaml.safe_load(PAPER_ARM.read_text())
    settings["travel_time"] *= SLOWNESS
    if SLOWNESS > 1:
        for k, channel in enumerate(settings["actuators"]):
            channel["node"], channel["output"] = 1 + k // 6, k % 6
            channel["input"] = channel["output"]
    for name in ("heartbeat", "boot_timeout"):
        settings["boards"][name] *= SLOWNESS
    settings["boards"]["heartbeat_timeout"] = settings["planner_timeout"] = min(10.0 * SLOWNESS, 30.0)
    path = tmp_path_factory.mktemp("arm") / "planar16.yaml"
    path.write_text(yaml.safe_dump(settings))
    return path


@pytest.fixture(scope="session")
def arm(arm_file: Path) -> Arm:
    return load(arm_file)


@pytest.fixture(scope="session")
def manipulator(arm: Arm) -> Manipulator:
    return arm.manipulator


@pytest.fixture(scope="session")
def densities(arm: Arm) -> Densities:
    return load_or_map(arm.manipulator, 0.02, arm.level_pixels, shared_folder() / "cache" / "hyperbit")


@pytest.fixture(scope="session")
def solver(manipulator: Manipulator, densities: Densities) -> Solver:
    return Solver(manipulator, densities)


@pytest.fixture(scope="session")
def read(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Any], Arm]:
    path = tmp_path_factory.mktemp("config") / "arm.yaml"

    class Plain(yaml.SafeDumper):
        def ignore_aliases(self, data: Any) -> bool:
            return True

    def read(value: Any) -> Arm:
        path.write_text(yaml.dump(value, Dumper=Plain))
        return load(path)

    return read


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack
