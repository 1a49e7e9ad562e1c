"""Workers and kills change no byte of a study; the last file of its folder, because a worker takes long to start."""

from __future__ import annotations

import os
import signal
import subprocess
import sys

import pytest
from distributed import Client

import hyperbit as hb
from hyperbit.controller.design.explore import explore
from hyperbit.controller.design.kept import kept
from hyperbit.controller.studies.workers import local_workers
from tests.design.conftest import run
from tests.waiting import PATIENCE, eventually

COMMAND = [sys.executable, "-m", "hyperbit", "design"]


@pytest.fixture(scope="module")
def two() -> Client:
    with local_workers(2) as client:
        yield client


def test_two_workers_write_the_bytes_of_one_process_though_one_is_killed(two, study, tmp_path):
    run(study, tmp_path / "alone.jsonl", 16)
    run(study, tmp_path / "two.jsonl", 16, client=two)
    assert (tmp_path / "two.jsonl").read_bytes() == (tmp_path / "alone.jsonl").read_bytes()
    victim = two.run(os.getpid).popitem()[1]
    with kept(tmp_path / "killed.jsonl", study, 5, 16) as found:
        for step in explore(study, 16, 5, found, two):
            if step.part == "designs" and step.done == 3:
                os.kill(victim, signal.SIGKILL)
    assert (tmp_path / "killed.jsonl").read_bytes() == (tmp_path / "alone.jsonl").read_bytes()


def test_workers_need_no_optuna(two):
    def loaded() -> bool:
        return "optuna" in sys.modules

    assert not any(two.run(loaded).values())


def build(modules: int, width: float) -> hb.Arm:
    return hb.Arm([hb.vgt(width=width, lengths=(0.2, 0.25), count=modules)], tolerance=0.05)


def test_the_library_gives_the_same_front_by_a_cluster(two, tmp_path):
    parameters = {"modules": {"between": [2, 4]}, "width": {"between": [0.15, 0.3]}}
    study = hb.Study(build, parameters, [(0.0, 0.8), hb.Goal((0.1, 0.7), orientation=0.1)], name="mine")
    alone = hb.design(study, 10, 1, tmp_path / "1.jsonl")
    hb.design(study, 10, 1, tmp_path / "2.jsonl", client=two)
    assert (tmp_path / "1.jsonl").read_bytes() == (tmp_path / "2.jsonl").read_bytes()
    assert len(alone.evaluations) == 10
    assert "there are no new ones" in alone.table()


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
@pytest.mark.usefixtures("own_folders")
def test_a_command_that_is_ended_goes_on_with_its_file(written, tmp_path, number):
    path, file = tmp_path / "found.jsonl", written({"evaluations": 3000})
    words = [*COMMAND, str(file), "--output", str(path), "--arms", str(tmp_path / "arms")]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        eventually(lambda: path.exists() and path.read_bytes().count(b"\n") > 12)
        process.send_signal(number)
        out, err = process.communicate(timeout=PATIENCE)
    done = path.read_bytes().count(b"\n") - 1
    if number == signal.SIGINT:
        assert process.returncode == 130
        assert f"small: {done} designs" in out
        assert "goes on where it ended" in err
        assert hb.load(tmp_path / "arms" / "small-01.yaml").name == "small-01"
    count = done + 9
    for name in ("found.jsonl", "whole.jsonl"):
        hb.design(file, count, output=tmp_path / name)
    assert path.read_bytes() == (tmp_path / "whole.jsonl").read_bytes()
