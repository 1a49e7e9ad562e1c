"""Running arms, shared by tests that need the same one; an arm left in disorder is replaced."""

import json
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from hyperbit.controller.arm.arm import Arm
from hyperbit.drivers.simulation.simulation import Simulation
from tests import vcan
from tests.conftest import buses_of
from tests.emulated import Interface
from tests.system.stack import patience  # noqa: F401
from tests.system.stack.lives import Lives
from tests.system.stack.motions import Listener, Motions
from tests.system.stack.observer import Observer
from tests.system.stack.processes import nursery
from tests.system.stack.system import System, settled

KINDS = {"virtual": "emulated", "socketcan": "socketcan"}  # of buses, by the words of --bus
FAILED = pytest.StashKey[bool]()


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "arm(kind, **fields): the arm that a test runs, and fields of its file")
    config.addinivalue_line("markers", "fresh: the test starts the parts of its arm itself, and may leave disorder")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    only = config.getoption("bus")
    own = [item for item in items if Path(__file__).parent in item.path.parents]
    for item in own:
        item.add_marker("real_time")
        if not item.get_closest_marker("timeout"):
            item.add_marker(pytest.mark.timeout(600))
    if elsewhere := [item for item in own if only not in (None, *buses_of(item))]:
        items[:] = [item for item in items if item not in elsewhere]
        config.hook.pytest_deselected(items=elsewhere)


def pytest_collection_finish(session: pytest.Session) -> None:
    """Lets all processes of the tests share those that fork executors and planners."""
    if session.config.option.forks and any("system" in getattr(item, "fixturenames", ()) for item in session.items):
        nursery("executor"), nursery("planner")


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Runs a test on each kind of bus, or on those that its mark names."""
    if "kind" in metafunc.fixturenames:
        only = metafunc.config.getoption("bus")
        kinds = [KINDS[bus] for bus in buses_of(metafunc.definition) if only in (None, bus)]
        metafunc.parametrize("kind", kinds, indirect=True, scope="session")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Any:
    report = yield
    if report.failed:
        item.stash[FAILED] = True
        if "system" in getattr(item, "funcargs", {}):
            report.sections.append(("logs", item.funcargs["system"].logs()))
    return report


@pytest.fixture(scope="session")
def kind(request: pytest.FixtureRequest) -> str:
    if request.param == "socketcan" and (reason := vcan.missing()):
        (pytest.fail if request.config.getoption("bus") else pytest.skip)(reason)
    return str(request.param)


class Shared:
    """The arm of the last test, for the next test that needs the same one."""

    def __init__(self) -> None:
        self.wanted = ""
        self.system: System | None = None

    def take(self, wanted: str, make: Callable[[], System]) -> System:
        if self.wanted != wanted or self.system is None or not self._in_order(self.system):
            self.drop()
            self.wanted, self.system = wanted, make()
        return self.system

    def drop(self) -> None:
        if self.system is not None:
            self.system.close()
            self.system = None

    def _in_order(self, system: System) -> bool:
        with system.client() as client:
            return settled(client)


@pytest.fixture(scope="session")
def shared() -> Iterator[Shared]:
    shared = Shared()
    yield shared
    shared.drop()


@pytest.fixture
def system(request: pytest.FixtureRequest, kind: str, shared: Shared) -> Iterator[System]:
    """The arm of the test's mark; it is running unless the test is marked as fresh."""
    mark = request.node.get_closest_marker("arm")
    base, fields = (mark.args or ("planar",))[0] if mark else "planar", mark.kwargs if mark else {}

    def make() -> System:
        return System(kind, base, fields)

    if request.node.get_closest_marker("fresh"):
        shared.drop()  # otherwise it would slow this one down
        system = make()
        yield system
        system.close()
        return
    yield shared.take(json.dumps([kind, base, fields]), lambda: started(make()))
    if request.node.stash.get(FAILED, False):
        shared.drop()


def started(system: System) -> System:
    try:
        return system.start()
    except BaseException:
        system.close()
        raise


@pytest.fixture
def arm(system: System) -> Arm:
    return system.arm


@pytest.fixture
def boards(system: System) -> Simulation:
    return system.boards


@pytest.fixture
def interface(system: System) -> Interface | vcan.Interface:
    return system.interface


@pytest.fixture
def listener(system: System) -> Iterator[Listener]:
    with system.listener() as listening:
        yield listening


@pytest.fixture
def motions(system: System, listener: Listener) -> Motions:
    motions = Motions(system.wiring, listener, system.interface.flush, system.drives())
    motions.begin(system.boards)
    return motions


@pytest.fixture
def client(system: System, motions: Motions, request: pytest.FixtureRequest) -> Iterator[Observer]:
    """A client of an arm that is ready. At the end, all motion was for goals, and each goal has one result."""
    with system.client() as client:
        client.wait_for("ready")
        yield client
        if not request.node.stash.get(FAILED, False):
            motions.check(client, system.boards)


@pytest.fixture
def lives(system: System, stack: ExitStack) -> Lives:
    """Planner and executor in processes of their own, ready."""
    lives = Lives(system, stack)
    lives.ready()
    return lives
