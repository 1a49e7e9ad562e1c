"""The catalog explains each kind of message, and systemd accepts it."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from hyperbit.controller.executor.core import modes
from hyperbit.controller.host.journal import message_id
from hyperbit.controller.panel.arms.faults import ADVICE
from hyperbit.controller.refusals.reasons import Reason
from tests.deploy.catalog import OTHERS, PATH, text
from tests.keys import DEPLOY


def test_the_file_is_up_to_date() -> None:
    assert PATH.read_text() == text(), "python -m tests.deploy.catalog"


def test_every_kind_has_one_entry() -> None:
    ids = re.findall(r"^-- ([0-9a-f]{32})$", PATH.read_text(), re.MULTILINE)
    assert len(ids) == len(set(ids)) == len(ADVICE) + len(OTHERS) + len(Reason)
    words = Path(modes.__file__).parents[2] / "program" / "parts.py"
    for mode in re.findall(r"Mode = Literal\[([^\]]+)\]", words.read_text())[0].replace('"', "").split(", "):
        assert message_id(f"mode-{mode}") in ids


def test_the_install_script_brings_it() -> None:
    install = (DEPLOY / "install.sh").read_text()
    assert "hyperbit.catalog" in install
    assert "journalctl --update-catalog" in install


@pytest.mark.skipif(shutil.which("journalctl") is None, reason="journalctl is missing")
def test_systemd_takes_it(tmp_path: Path) -> None:
    folder = tmp_path / "usr" / "lib" / "systemd" / "catalog"
    folder.mkdir(parents=True)
    (tmp_path / "var" / "lib" / "systemd" / "catalog").mkdir(parents=True)
    shutil.copy(PATH, folder)

    def journalctl(*words: str) -> str:
        command = ["journalctl", f"--root={tmp_path}", *words]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout

    journalctl("--update-catalog")
    told = journalctl("--dump-catalog", message_id("board-lost"))
    assert "Fault board-lost" in told
    assert "supply" in told
    assert len(journalctl("--list-catalog").splitlines()) == len(ADVICE) + len(OTHERS) + len(Reason)
