"""The command record: sizes, messages about bad input, imports."""

import subprocess
import sys
from pathlib import Path

import pytest

from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands.serve import record
from hyperbit.controller.commands.serve.record import parse_size
from tests.commands.conftest import Told
from tests.keys import DEPLOY


@pytest.mark.parametrize(
    ("text", "size"), [("100000", 100_000), ("200M", 200 * 10**6), ("2g", 2 * 10**9), ("1T", 10**12), ("500k", 500_000)]
)
def test_sizes(text: str, size: int) -> None:
    assert parse_size(text, "--size") == size


@pytest.mark.parametrize("text", ["", "M", "-5M", "1.5G", "10", "2GB", "x", "٣M"])
def test_no_sizes(text: str) -> None:
    with pytest.raises(InputFaults):
        parse_size(text, "--size")


def test_bad_input_gives_a_message(told: Told, tmp_path: Path) -> None:
    assert "a number of bytes is needed" in told("record", "a", "--size", "much", code=2)
    assert "a number above 0" in told("record", "a", "--minutes", "0", code=2)
    assert "no-such.yaml" in told("record", "no-such.yaml", code=2)
    folder = ["--folder", str(tmp_path / "recordings")]
    assert "--can needs the arm's file" in told("record", "planar16", "--can", *folder, code=2)
    zenoh = ["--zenoh", str(tmp_path / "none.json5")]
    assert "No such file" in told("record", "planar16", *zenoh, *folder, code=2)
    (tmp_path / "file").touch()
    words = told("record", str(DEPLOY / "planar16.yaml"), "--folder", str(tmp_path / "file"), code=1)
    assert "recordings cannot be written" in words


def test_recording_needs_neither_kernels_nor_pictures() -> None:
    script = (
        "import sys, hyperbit.controller.commands.serve.record, hyperbit.controller.recorder.recorder\n"
        "import hyperbit.controller.network.listener\n"
        "print([name for name in ('numba', 'scipy', 'matplotlib', 'canopen', 'can') if name in sys.modules])"
    )
    told = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert told.stdout.strip() == "[]"


def test_the_daemon_needs_nothing_of_the_recorder() -> None:
    script = (
        "import sys\nsys.modules['mcap'] = None\n"
        "import hyperbit.controller.gateway.daemon, hyperbit.controller.executor.process.run\n"
        "import hyperbit.controller.commands.operate.run, hyperbit.controller.cli\n"
        "from hyperbit.controller.commands.serve.record import require\n"
        "print(any(name.startswith('hyperbit.controller.recorder') for name in sys.modules))"
    )
    told = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert told.stdout.strip() == "False"


def test_events_of_another_user_need_sudo(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def deny(path: Path) -> bytes:
        raise PermissionError(13, "Permission denied", str(path))

    (tmp_path / "hyperbit-1001-planar16-executor-7.0.events").touch()
    (tmp_path / "hyperbit-1001-other-planar16-planner-7.0.events").touch()
    monkeypatch.setattr(record, "SHARED", tmp_path)
    assert record.record_events("planar16", tmp_path)[0] == []
    monkeypatch.setattr(record, "read_generation", deny)
    saved, missing = record.record_events("planar16", tmp_path)
    assert saved == []
    assert "the executor runs as another user: use sudo" in missing[0]
