"""The command replay: messages about bad files, truncated files and wrong arms."""

import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from tests.commands.conftest import Told
from tests.keys import DEPLOY
from tests.recorder.samples import written


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    """A recording without a description of the arm."""
    recording = written(tmp_path / "a.mcap")
    recording.close()
    return recording.path


def test_bad_options_give_a_message(told: Told, recording: Path) -> None:
    assert "--speed" in told("replay", str(recording), "--speed", "0", code=2)
    assert "--from" in told("replay", str(recording), "--from", "-1", code=2)
    assert "only with --goals" in told("replay", str(recording), "--arm", "arm.yaml", code=2)
    for prefix in ("hyperbit", "a/hyperbit", "", "a//b", "*", "a b", "@x"):
        words = told("replay", str(recording), "--prefix", prefix, code=2)
        assert "not hyperbit, the prefix of running daemons" in words
    assert "nobody listens at tcp/127.0.0.1:1" in told("replay", str(recording), "--connect", "tcp/127.0.0.1:1", code=1)


def test_bad_files_give_a_message(told: Told, recording: Path, tmp_path: Path) -> None:
    assert "No such file" in told("replay", str(tmp_path / "none.mcap"), code=2)
    (tmp_path / "text.mcap").write_text("no recording")
    assert "no MCAP file" in told("replay", str(tmp_path / "text.mcap"), code=2)
    data = recording.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[:30])
    assert "of no arm" in told("replay", str(tmp_path / "cut.mcap"), code=2)


def test_a_recording_without_the_arms_file_needs_one(told: Told, recording: Path) -> None:
    assert "name it by --arm" in told("replay", str(recording), "--goals", code=1)


def test_a_wrong_arm_is_refused(told: Told, recording: Path, tmp_path: Path) -> None:
    planar = str(DEPLOY / "planar16.yaml")
    words = told("replay", str(recording), "--goals", "--arm", planar, code=2)
    assert "the file describes the arm 'planar16', the recording is of 'a'" in words
    path = tmp_path / "wrong.yaml"
    path.write_text(yaml.safe_dump({"name": "a", "modules": 3}))
    assert "modules" in told("replay", str(recording), "--goals", "--arm", str(path), code=2)


def test_a_recording_is_replayed_to_its_end(recording: Path, tmp_path: Path) -> None:
    recording.write_bytes(recording.read_bytes()[:-20])
    words = [str(recording), "--speed", "1000", "--listen", f"unixsock-stream/{tmp_path}/z.sock"]
    ended = subprocess.run([sys.executable, "-m", "hyperbit", "replay", *words], capture_output=True, text=True)
    assert ended.returncode == 0, ended.stderr
    assert "is incomplete: its readable part is replayed" in ended.stderr
