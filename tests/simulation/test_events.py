"""Recorded events: a whole run is replayed with the same actions; a difference is named; the files are safe to load."""

from __future__ import annotations

import itertools
import os
import pickle
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from hyperbit.controller.arm import arm as config
from hyperbit.controller.executor.core.events import SendFrame
from hyperbit.controller.executor.process.server import ExecutorServer
from hyperbit.controller.flight_recorder import FlightRecorder, Label
from hyperbit.controller.flight_recorder import recorder as recording
from hyperbit.controller.flight_recorder.recorder import LEFT_OUT
from hyperbit.controller.host import keeper
from hyperbit.controller.host.keeper import KEPT, LENGTH, RefusedFile, save
from hyperbit.controller.host.process import Log
from hyperbit.controller.obstacles.obstacles import sphere
from hyperbit.controller.planning.core.core import OPAQUE
from hyperbit.controller.planning.core.events import Answered, Start
from hyperbit.controller.planning.core.tasks import BuildScene, SceneBuilt, Tables, VersionedScene
from tests.keys import DEPLOY
from tests.simulation.events import arm_objects, main, replay, same
from tests.simulation.loading import load, unpickle
from tests.simulation.world import World

LABEL = Label("executor", f"recorded-{os.getpid()}", "digest")


@pytest.fixture
def recorder() -> Iterator[FlightRecorder]:
    with FlightRecorder(LABEL, None) as recorder:
        yield recorder


def run(recorder: FlightRecorder, seed: int, steps: int) -> World:
    world = World(seed)
    core = world.executor.core
    assert core is not None
    world.executor.recorder = recorder
    recorder.begin(core, lambda count: core.calm)
    world.run(steps)
    return world


@pytest.mark.parametrize("seed", range(2))
def test_a_run_with_checkpoints_is_reproduced(
    recorder: FlightRecorder, seed: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recording, "WANTED", 400)
    run(recorder, seed, 4000)
    generations = load(save(recorder.paths, tmp_path, "request"))
    assert [generation.core is not None for generation in generations] == [True, True]
    assert generations[1].about["number"] > 1, "checkpoints were taken in the run"
    found = replay(generations)
    assert (found.difference, found.skipped) == (None, 0)
    assert found.count == sum(len(generation.entries) for generation in generations)


def test_the_first_different_action_is_named(
    recorder: FlightRecorder, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    run(recorder, 1, 300)
    path = save(recorder.paths, tmp_path, "request")
    assert main(path) == 0
    assert "all actions reproduced" in capsys.readouterr().out
    generations = load(path)
    number, entry = next(
        (k, entry)
        for k, entry in enumerate(generations[-1].entries)
        if any(isinstance(a, SendFrame) for a in entry.actions)
    )
    first = next(k for k, action in enumerate(entry.actions) if isinstance(action, SendFrame))
    sent = entry.actions[first]
    entry.actions[first] = sent._replace(bus="another")
    difference = replay(generations).difference
    assert difference is not None
    assert difference.number == sum(len(one.entries) for one in generations[:-1]) + number + 1
    words = difference.words()
    assert all(part in words for part in (f"action {first + 1} recorded", "another", sent.bus, str(entry.event)))


def test_an_exception_in_a_step_is_recorded_and_reproduced(recorder: FlightRecorder, tmp_path: Path) -> None:
    world = run(recorder, 1, 300)
    recorder("no event", world.agenda.now, None, None)
    found = replay(load(save(recorder.paths, tmp_path, "exception")))
    assert found.core is not None  # the executor survives any exception: it faults
    assert found.difference is not None
    assert "recorded: an exception" in found.difference.words()


def test_without_a_calm_moment_the_ring_goes_on(recorder: FlightRecorder, tmp_path: Path) -> None:
    recorder.begin([lambda: None], lambda count: True)  # cannot be pickled
    for k in range(recording.MOST + 3):
        recorder(k, 0.0, None, [])
    generations = load(save(recorder.paths, tmp_path, "request"))
    assert [generation.core for generation in generations] == [None, None]
    assert [entry.event for entry in generations[1].entries] == [recording.MOST + k for k in range(3)]
    assert replay(generations).skipped == recording.MOST + 3


def test_the_last_block_of_a_killed_process_may_be_cut(recorder: FlightRecorder, tmp_path: Path) -> None:
    recorder.begin((), lambda count: False)
    recorder("whole", 0.0, None, [])
    recorder("cut", 0.0, None, [])
    path = recorder.paths[0]
    path.write_bytes(path.read_bytes()[:-1])
    (generation,) = load(save(recorder.paths, tmp_path, "request"))
    assert [entry.event for entry in generation.entries] == ["whole"]


def test_opaque_values_are_left_out_and_constant_ones_are_made_from_the_arms_file(tmp_path: Path) -> None:
    file = DEPLOY / "planar16.yaml"
    arm, other = config.load(file), config.load(file)
    label = Label("planner", LABEL.arm, "digest", file.read_text())
    pillar = sphere("pillar", [1.0, 2.0], 0.5)
    tables = Tables(3, b"abc", solvers=lambda: None)
    with FlightRecorder(label, None, OPAQUE, {"manipulator": arm.manipulator}) as recorder:
        recorder.begin([arm.manipulator, tables], lambda count: True)
        scene = SceneBuilt(VersionedScene(4, False, keep_out=object()), 1, 1)
        recorder(Answered(7, scene, True), 1.0, 2.0, (Start(8, BuildScene(5, pillar)),))
        (generation,) = load(save(recorder.paths, tmp_path, "request"), arm_objects)
        recorder.begin([other.manipulator], lambda count: True)
        assert load(save(recorder.paths, tmp_path, "other"), arm_objects)[1].core is None, "it is not the one by name"
    manipulator, found = generation.core
    assert (type(manipulator), len(manipulator.actuators)) == (type(arm.manipulator), 48)
    assert found == Tables(3, b"abc", LEFT_OUT)
    (entry,) = generation.entries
    assert entry[:3] == (Answered(7, SceneBuilt(VersionedScene(4, False, LEFT_OUT), 1, 1), True), 1.0, 2.0)
    assert same(entry.actions, [Start(8, BuildScene(5, pillar))])
    with pytest.raises(RefusedFile, match="needs 'manipulator'"):
        load(tmp_path / next(path.name for path in tmp_path.iterdir() if "-request-" in path.name))


class Called:
    """A pickle of it calls a function."""

    def __init__(self, function: Callable[..., Any], *arguments: object) -> None:
        self.function, self.arguments = function, arguments

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[object, ...]]:
        return self.function, self.arguments


@pytest.mark.parametrize(
    ("content", "word"),
    [
        (Called(os.system, "true"), "system"),
        (Called(eval, "1"), "builtins.eval"),
        (Called(getattr, "", "join"), "builtins.getattr"),
        (Called(ExecutorServer, Path("x")), "server.ExecutorServer"),
        (Called(keeper.save, (), Path("x"), ""), "keeper.save"),
        (Called(recording.method_of, Path("x"), "unlink"), "PosixPath"),
        (Called(recording.method_of, [], "append"), "method 'append'"),
    ],
)
def test_a_pickle_that_does_anything_is_refused(content: Called, word: str) -> None:
    with pytest.raises(RefusedFile, match=word):
        unpickle(pickle.dumps(content, 5))


def test_modules_inside_pure_modules_are_refused() -> None:
    for name in ("logging", "traceback.linecache.os.system"):
        with pytest.raises(RefusedFile, match="not loaded"):
            unpickle(
                f"\x80\x04\x8c\x21hyperbit.controller.executor.core\x8c{chr(len(name))}{name}\x93.".encode("latin1")
            )


@pytest.mark.parametrize("content", [b"", b"hyperbit events 1\n{}\nnonsense", b"hyperbit events 2\n{}\n"])
def test_damaged_files_are_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "file"
    path.write_bytes(content)
    with pytest.raises(RefusedFile, match=str(path)):
        load(path)


@pytest.mark.parametrize(
    "beginning",
    ['{"kind": "../../x", "arm": "a"', '{"kind": "executor", "arm": "../a"', '{"kind": "executor", "arm": 1'],
)
def test_the_beginning_cannot_name_another_folder(beginning: str, tmp_path: Path) -> None:
    path = tmp_path / "ring"
    path.write_text(beginning + ', "number": 0, "checkpoint": 0}\n')
    with pytest.raises(RefusedFile, match="beginning"):
        save([path], tmp_path / "files", "request")
    (link := tmp_path / "link").symlink_to(path)
    with pytest.raises(OSError, match="symbolic"):
        save([link], tmp_path / "files", "request")


def test_only_the_newest_files_are_kept(recorder: FlightRecorder, tmp_path: Path) -> None:
    recorder.begin((), lambda count: False)
    for k in range(KEPT + 3):
        (tmp_path / f"{LABEL.arm}.events-202001{k + 1:02}T000000Z-executor-old").touch()
    others = [tmp_path / f"{LABEL.arm}.switches", tmp_path / f"{LABEL.arm}.events-20200101T000000Z-planner-old"]
    for path in others:
        path.touch()
    newest = save(recorder.paths, tmp_path, "Board lost!", KEPT)
    assert newest.name.endswith("-executor-board-lost-1")
    kept = sorted(path.name for path in tmp_path.glob("*-executor-*"))
    assert (len(kept), kept[-1], "20200105" in kept[0]) == (KEPT, newest.name, True)
    assert all(path.exists() for path in others)


def test_the_newest_files_are_kept_though_the_clock_is_set_back(
    recorder: FlightRecorder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorder.begin((), lambda count: False)
    times = map(time.gmtime, itertools.count(1e9, -1e6))
    monkeypatch.setattr(keeper, "time", SimpleNamespace(gmtime=times.__next__, strftime=time.strftime, time=time.time))
    files = [save(recorder.paths, tmp_path, "Board lost!", KEPT) for _ in range(2 * KEPT)]
    assert [path.exists() for path in files] == [False] * KEPT + [True] * KEPT


def test_the_keeper_saves_once_a_minute_and_after_a_kill(recorder: FlightRecorder, tmp_path: Path) -> None:
    recorder.begin((), lambda count: False)
    command = [sys.executable, "-I", "-S", keeper.__file__, "events", str(tmp_path), *map(str, recorder.paths)]
    ended = subprocess.run(command, input=b"bus-down\nbus-down\nstuck\n", capture_output=True, check=True)
    causes = sorted(path.name.split("-executor-")[1] for path in tmp_path.iterdir())
    assert causes == ["bus-down-1", "killed-2"], ended.stderr
    assert not any(path.exists() for path in recorder.paths)


def test_an_error_in_the_log_is_saved(recorder: FlightRecorder, monkeypatch: pytest.MonkeyPatch) -> None:
    causes = list[str]()
    monkeypatch.setattr(FlightRecorder, "save", lambda self, cause: causes.append(cause))
    recorder.begin((), lambda count: False)
    recorder("x", 0.0, None, [Log(30, "a warning", {"HYPERBIT_FAULT": "degraded"})])
    recorder("x", 0.0, None, [Log(40, "a fault", {"HYPERBIT_FAULT": "stuck"})])
    recorder("x", 0.0, None, [Log(40, "a defect")])
    recorder("x", 0.0, None, None)
    assert causes == ["stuck", "error", "exception"]


def test_blocks_are_readable_before_the_process_ends(recorder: FlightRecorder) -> None:
    recorder.begin((), lambda count: False)
    recorder("x", 1.0, 2.0, [])
    content = recorder.paths[0].read_bytes()
    size = keeper.about(content)["checkpoint"]
    place = content.index(b"\n") + 1 + size
    assert LENGTH.unpack_from(content, place)[0] == len(content) - place - LENGTH.size
