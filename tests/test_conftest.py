"""A test that hangs fails soon, and leaves no process behind."""

import os
import subprocess
import sys
from pathlib import Path

from tests.waiting import eventually

HANGS = """
import subprocess

def test_hangs(tmp_path_factory):
    process = subprocess.Popen(["sleep", "600"], start_new_session=True)
    with open("pid", "w") as file:
        file.write(str(process.pid))
    process.wait()
"""


def test_a_process_of_a_test_that_hangs_is_killed(tmp_path: Path) -> None:
    (tmp_path / "test_hangs.py").write_text(HANGS)
    root = Path(__file__).parents[1]
    words = ["-m", "pytest", "-p", "tests.conftest", "-p", "no:xdist", "--timeout", "1", "test_hangs.py"]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(root), os.environ.get("PYTHONPATH", "")])}
    run = subprocess.run([sys.executable, *words], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert (run.returncode, "Timeout" in run.stdout) == (1, True), run.stdout + run.stderr
    pid = (tmp_path / "pid").read_text()
    eventually(lambda: not Path(f"/proc/{pid}").exists())
