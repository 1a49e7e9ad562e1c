"""Commands that draw, where matplotlib is not installed: they say so before the work begins."""

import subprocess
import sys
from pathlib import Path

import pytest

from tests.commands.conftest import ARM

HIDE = """
import sys
from importlib.machinery import PathFinder
find = PathFinder.find_spec
PathFinder.find_spec = lambda name, *more: None if name.startswith(("matplotlib", "PIL")) else find(name, *more)
from hyperbit.controller import cli
cli.main()
"""


@pytest.mark.parametrize(
    "words",
    [
        ["demo"],
        ["figure5"],
        ["workspace", str(ARM)],
        ["check", str(ARM), "--picture", "arm.png"],
        ["check", str(ARM), "--wiring", "w.png"],
    ],
    ids=lambda words: " ".join(words[:1] + words[2:3]),
)
def test_what_is_missing_and_its_installation_are_named(words: list[str], tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-c", HIDE, *words], cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == "pictures need matplotlib\nNext: pip install 'hyperbit[pictures]'\n"
    assert list(tmp_path.iterdir()) == []
