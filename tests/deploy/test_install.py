"""install.sh: what it refuses before it looks at the computer. tests/vm runs the rest."""

import shutil
import subprocess

import pytest

from tests.keys import DEPLOY

SCRIPTS = sorted(DEPLOY.glob("*.sh"))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--bakc"], "--bakc: no such option; there are --without PARTS, --switch and --back"),
        (["--without"], "--without needs parts: panel, pictures, recorder or ros2, with commas"),
        (["--without", "panel,plots"], "plots: no such part; there are panel, pictures, recorder and ros2"),
        (["--back", "a.yaml"], "--back takes neither parts nor a file: the version has them"),
        (["--switch", "--without", "panel"], "--switch takes neither parts nor a file: the version has them"),
        (["a.yaml", "b.yaml"], "two files of an arm, a.yaml and b.yaml: give one; others are instances, see README.md"),
        (["missing.yaml"], "missing.yaml: no such file"),
    ],
)
def test_unusable_words_are_named_with_what_would_be_right(words: list[str], said: str) -> None:
    done = subprocess.run([DEPLOY / "install.sh", *words], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (1, "", f"install: {said}\n")


@pytest.mark.skipif(shutil.which("shellcheck") is None, reason="shellcheck is missing")
@pytest.mark.parametrize("script", SCRIPTS, ids=lambda path: path.name)
def test_shellcheck_finds_nothing(script) -> None:
    done = subprocess.run(["shellcheck", script], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
