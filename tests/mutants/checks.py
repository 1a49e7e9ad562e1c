"""Looks for a planted defect: by the simulation, and by the tests of the room. Each runs in a child of its own."""

from __future__ import annotations

import json
import logging
import os
import signal
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from tests.mutants.forks import Result
from tests.mutants.sites import Mutant
from tests.mutants.started import sitecustomize

ROOT = Path(__file__).parents[2]
STUCK_AFTER = 20.0  # [s] of processor time in one step of the simulation: an endless loop
TEST_TIMEOUT = 120  # [s] of one test
LONGEST = 300  # characters of a reason

COMPILING = 600.0  # [s] of processor time: a defect of a kernel makes all kernels compile anew
MESSAGES_A_SEED = 3_000  # of a world of ROS 2

# Tests of each room, the likely finders first. The simulation has run before. A file belongs to its innermost room.
_OF_BOARDS = ("tests/drivers", "tests/second_opinion", "tests/executor")
TESTS = {
    "controller/commands": ("tests/commands",),
    "controller/executor/arm": ("tests/executor",),
    "controller/executor/core": ("tests/executor", "tests/fuzz"),
    "controller/executor/motion": ("tests/executor",),
    "controller/executor/process": ("tests/executor",),
    "controller/gateway": ("tests/gateway", "tests/planning"),
    "controller/motion": ("tests/motion", "tests/planning"),
    "controller/network": ("tests/network", "tests/gateway"),
    "controller/obstacles": ("tests/obstacles", "tests/motion", "tests/library"),
    "controller/panel": ("tests/panel",),
    "controller/planning": ("tests/planning", "tests/gateway"),
    "controller/planning/core": ("tests/planning", "tests/fuzz"),
    "controller/recorder": ("tests/recorder",),
    "controller/ros2": ("tests/ros2",),
    "controller/search": ("tests/search", "tests/bench"),
    "drivers/canopen/boards": _OF_BOARDS,
    "drivers/canopen/boot": _OF_BOARDS,
    "drivers/canopen/run": _OF_BOARDS,
    "drivers/canopen/sdo": _OF_BOARDS,
    "drivers/canopen/wire": _OF_BOARDS,
    "drivers/simulation": ("tests/drivers", "tests/simulation"),
}


def room_of(file: str) -> str:
    """Returns the innermost room of a file, "" if no room has it."""
    return max((room for room in TESTS if file.startswith(f"{room}/")), key=len, default="")


class Stuck(BaseException):
    """One step of the simulation does not end."""


def warm_up() -> None:
    """Imports what takes long and depends on no room with defects."""
    import can  # noqa: F401
    import hypothesis  # noqa: F401
    import pytest  # noqa: F401
    import zenoh  # noqa: F401

    import hyperbit.controller.arm.arm
    import hyperbit.controller.motion.stages.pacing
    import hyperbit.controller.motion.tracking.tracking
    import hyperbit.controller.search.solver
    import hyperbit.controller.workspace.cache  # noqa: F401


def simulate(mutant: Mutant | None, steps: int, first: int = 0) -> Result:
    """Runs worlds of all kinds in turn until one fails, or until they have run all steps."""
    with tempfile.TemporaryDirectory(prefix="mutant-") as folder:
        if mutant is not None:
            _plant(mutant, folder)
        of_ros2 = mutant is not None and room_of(mutant.file) == "controller/ros2"
        try:
            from tests.ros2.world.world import World
            from tests.simulation.__main__ import KINDS, STEPS_A_SEED, Turns, world_of
            from tests.simulation.whole.planner_process import LOGS
        except Exception as error:
            return {"found": True, "why": f"import: {_told(error)}"}
        if mutant is not None and mutant.module not in sys.modules:
            return {"found": False, "why": "the simulation does not import the module"}
        for log in LOGS:
            log.setLevel(logging.CRITICAL + 1)
        turns = Turns(("ros2",) if of_ros2 else KINDS, first)
        while turns.steps < steps:
            kind, seed = turns.next()
            watch, why = _Watch(), ""
            try:
                if of_ros2:
                    watch.world = world = World(Path(tempfile.mkdtemp(dir=folder)), seed)
                    world.run(MESSAGES_A_SEED)
                else:
                    watch.world = simulated = world_of(seed, kind)
                    simulated.run(min(STEPS_A_SEED[kind], steps - turns.steps))
            except Stuck:
                why = "does not end"
            except BaseException as error:
                why = _told(error)
            watch.end()
            turns.ran(kind, MESSAGES_A_SEED if of_ros2 else watch.step)
            if why:
                return {"found": True, "why": why, "seed": seed, "kind": kind, "step": watch.step, "steps": turns.steps}
    return {"found": False, "why": "", "steps": turns.steps}


def _plant(mutant: Mutant, folder: str) -> None:
    """Plants a defect in this process, and for processes that tests start."""
    if mutant.module in sys.modules:  # of the warm process: all of the program and of its worlds is imported anew
        for name in [name for name in sys.modules if name.startswith(("hyperbit", "tests."))]:
            if not name.startswith("tests.mutants"):
                del sys.modules[name]
    if mutant.kernel:  # compiled code of other modules may contain the kernel, and its cache does not know
        import numba

        numba.config.CACHE_DIR = os.environ["NUMBA_CACHE_DIR"] = folder
    sitecustomize.plant(mutant.module, str(ROOT / mutant.file), mutant.source)


class _Watch:
    def __init__(self) -> None:
        self.world: Any = None
        self._seen = -1
        signal.signal(signal.SIGVTALRM, self._look)
        signal.setitimer(signal.ITIMER_VIRTUAL, STUCK_AFTER, STUCK_AFTER)

    @property
    def step(self) -> int:
        agenda = getattr(self.world, "agenda", None)
        if agenda is not None:
            return int(agenda.steps)
        return 0 if self.world is None else int(self.world.clock.now * 1e6)  # a world of ROS 2

    def end(self) -> None:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)

    def _look(self, number: int, frame: object) -> None:
        if self.step == self._seen:
            raise Stuck
        self._seen = self.step


def run_tests(mutant: Mutant | None, files: Iterable[str]) -> Result:
    """Runs test files until a test fails."""
    import pytest

    seen = _FirstFailure()
    with tempfile.TemporaryDirectory(prefix="mutant-") as folder:
        if mutant is not None:
            _plant(mutant, folder)
            source = Path(folder, "mutant.py")
            source.write_text(mutant.source)
            os.environ[sitecustomize.MUTANT] = json.dumps([mutant.module, str(ROOT / mutant.file), str(source)])
        started = str(Path(sitecustomize.__file__).parent)
        os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, [started, os.environ.get("PYTHONPATH")]))
        os.chdir(ROOT)
        options = [
            "-x",
            "-q",
            "-p",
            "no:cacheprovider",
            "--timeout",
            str(TEST_TIMEOUT),
            "--basetemp",
            f"{folder}/t",
        ]
        code = pytest.main([*options, *files], plugins=[seen])
    if code in (pytest.ExitCode.USAGE_ERROR, pytest.ExitCode.NO_TESTS_COLLECTED) and mutant is None:
        raise RuntimeError(f"pytest cannot run {' '.join(files)}: {code!r}")
    return {"found": code != pytest.ExitCode.OK, "why": seen.why, "test": seen.test}


class _FirstFailure:
    test = why = ""

    def pytest_runtest_logreport(self, report: Any) -> None:
        self._take(report)

    def pytest_collectreport(self, report: Any) -> None:
        self._take(report)

    def _take(self, report: Any) -> None:
        if report.failed and not self.test:
            crash = getattr(report.longrepr, "reprcrash", None)
            self.test = report.nodeid
            self.why = " ".join(str(crash.message if crash else report.longrepr).split())[:LONGEST]


def ordered_tests(room: str, mutant: Mutant | None, finders: Iterable[str] = ()) -> list[str]:
    """Returns the test files of a room; those that have found defects of this module, or mirror it, come first."""
    files = [
        path.relative_to(ROOT).as_posix()
        for folder in TESTS[room]
        for path in sorted((ROOT / folder).rglob("test_*.py"))
    ]
    if mutant is None:
        return files
    parts = mutant.file.removesuffix(".py").split("/")
    finders = list(finders)

    def rank(file: str) -> tuple[int, int, int, int]:
        text = (ROOT / file).read_text()
        words = set(Path(file).stem.removeprefix("test_").split("_"))
        return (
            -finders.count(file),
            -len(words & {*parts[-1].split("_"), parts[-1]}),
            mutant.module not in text,
            -len({*parts[:-1]} & set(file.split("/"))),
        )

    return sorted(files, key=rank)


def _told(error: BaseException) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:LONGEST]
