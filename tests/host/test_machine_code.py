"""The machine code of the kernels: its folder, and damaged files."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from hyperbit.controller.host import machine_code
from tests.commands.conftest import ARM

CHECK = """
import sys
from pathlib import Path
from hyperbit.controller.host import machine_code
machine_code.PACKAGE = Path(sys.argv[1])  # nothing is compiled there
machine_code.usual_folders = lambda: [Path(folder) for folder in sys.argv[2:]]
assert "numba" not in sys.modules
machine_code.watch()
machine_code.watch()
sys.path.insert(0, sys.argv[1])
import kernels_of_a_test
print(kernels_of_a_test.twice(4))
"""
KERNEL = "from numba import njit\n\n@njit('i8(i8)', cache=True)\ndef twice(x):\n    return 2 * x\n"


@pytest.fixture
def nowhere(tmp_path: Path) -> Path:
    """A file: no folder can be created below it, not even by root."""
    path = tmp_path / "file"
    path.write_text("")
    return path / "folder"


def test_a_usual_folder_is_used_without_a_word(tmp_path, nowhere):
    before = os.environ.get(machine_code.VARIABLE)
    assert machine_code.choose([nowhere, tmp_path / "new" / "folder"]) is None
    assert os.environ.get(machine_code.VARIABLE) == before


def test_kernels_are_compiled_where_no_usual_folder_can_be_written(tmp_path, nowhere):
    package = tmp_path / "package"
    package.mkdir()
    (package / "__pycache__").write_text("")  # numba tries this folder first
    (package / "kernels_of_a_test.py").write_text(KERNEL)
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    environment = {**os.environ, "TMPDIR": str(temporary), "XDG_CACHE_HOME": str(nowhere), "NUMBA_CACHE_DIR": ""}
    environment["PYTHONPATH"] = str(ARM.parents[1])
    ran = subprocess.run(
        [sys.executable, "-c", CHECK, str(package), str(nowhere)],
        capture_output=True,
        text=True,
        env=environment,
        check=False,
    )
    assert (ran.returncode, ran.stdout) == (0, "8\n"), ran.stderr
    folder = temporary / f"hyperbit-numba-{os.getuid()}"
    assert ran.stderr == (
        f"numba cannot write its machine code to {nowhere}; it goes to {folder}, where it may be deleted. To keep it,"
        " set NUMBA_CACHE_DIR to a folder that you can write\n"
    )
    assert any(folder.rglob("*.nbi"))


@pytest.mark.parametrize("fault", ["open to others", "a link"])
def test_a_temporary_folder_that_others_can_write_is_not_used(tmp_path, nowhere, monkeypatch, fault):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr(machine_code, "PACKAGE", tmp_path)
    folder = tmp_path / f"hyperbit-numba-{os.getuid()}"
    if fault == "a link":
        (tmp_path / "other").mkdir(mode=0o700)
        folder.symlink_to(tmp_path / "other")
    else:
        folder.mkdir()
        folder.chmod(0o777)
    before = os.environ.get(machine_code.VARIABLE)
    told = machine_code.choose([nowhere])
    assert told == (
        f"numba cannot write its machine code to {nowhere}, and no temporary folder can be written: set NUMBA_CACHE_DIR"
        " to a folder that you can write"
    )
    assert os.environ.get(machine_code.VARIABLE) == before


KEPT = """
import os, sys
import hyperbit.controller
from numba import njit
njit("i8(i8)")(lambda x: x)  # loads the compiler once, for all processes
sys.path.insert(0, sys.argv[1])
for _ in sys.stdin:
    if os.fork() == 0:
        import kernels_of_a_test
        print(kernels_of_a_test.twice(4), sum(kernels_of_a_test.twice.stats.cache_hits.values()), flush=True)
        os._exit(0)
    os.wait()
"""


@contextmanager
def kernel(folder: Path, **more: str) -> Iterator[Callable[[], str]]:
    """Yields a function that runs the kernel of a test in a new process; it returns the result and the cache hits."""
    if not (module := folder / "kernels_of_a_test.py").exists():
        module.write_text(KERNEL)
    command, pipe = [sys.executable, "-c", KEPT, folder], subprocess.PIPE
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder / "cache"), **more}
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=subprocess.STDOUT, text=True, env=environment) as it:

        def run() -> str:
            print(file=it.stdin, flush=True)
            return it.stdout.readline().strip()

        yield run
        assert it.communicate() == ("", None)


READ_ONLY = """
import tempfile

def refuse(*_, **__):
    raise OSError(30, "Read-only file system")

tempfile.TemporaryFile = refuse
"""


def test_a_read_only_installation_uses_its_compiled_kernels(tmp_path):
    with kernel(tmp_path, NUMBA_CACHE_DIR="") as ran:
        assert ran() == "8 0"
    (tmp_path / "sitecustomize.py").write_text(READ_ONLY)
    path = os.pathsep.join((str(tmp_path), str(ARM.parents[1] / ".package")))
    home = str(tmp_path / "home")
    with kernel(tmp_path, NUMBA_CACHE_DIR="", PYTHONPATH=path, TMPDIR=home, XDG_CACHE_HOME=home) as ran:
        assert ran() == "8 1"


def test_a_damaged_file_is_compiled_and_kept_again(tmp_path):
    with kernel(tmp_path) as ran:
        assert ran() == "8 0"
        for suffix in ("nbi", "nbc"):
            [file] = (tmp_path / "cache").rglob(f"*.{suffix}")
            whole = file.read_bytes()
            for damaged in (b"", whole[: len(whole) // 2], bytes(len(whole))):
                file.write_bytes(damaged)
                assert (ran(), ran()) == ("8 0", "8 1"), (suffix, len(damaged))


def test_a_full_disk_is_told_once(capsys):
    before = list(machine_code.told)
    machine_code.told.clear()
    for _ in range(2):
        with machine_code.forgiving(None):
            raise OSError(28, "No space left on device")
    machine_code.told[:] = before
    text = "numba cannot keep its machine code: [Errno 28] No space left on device; it is compiled again at each start"
    assert capsys.readouterr().err == f"{text}\n"
