"""The unit as systemd sees it, without a running systemd."""

import shutil
import subprocess

import pytest

from tests.keys import DEPLOY

pytestmark = pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is missing")

UNIT = str(DEPLOY / "hyperbit.service")


def test_the_unit_is_confined() -> None:
    command = ["systemd-analyze", "security", "--no-pager", "--offline=true", "--threshold=20", UNIT]
    ended = subprocess.run(command, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    assert "Overall exposure level for hyperbit.service" in ended.stdout


def test_the_unit_holds_no_unknown_setting() -> None:
    ended = subprocess.run(["systemd-analyze", "verify", UNIT], capture_output=True, text=True)
    told = [line for line in ended.stderr.splitlines() if "hyperbit.service" in line]
    assert [line for line in told if "is not executable" not in line] == []  # not installed here
