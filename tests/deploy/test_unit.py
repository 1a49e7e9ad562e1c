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


def test_the_unit_permits_real_time() -> None:
    settings = [line for line in (DEPLOY / "hyperbit.service").read_text().splitlines() if "=" in line]
    for needed in ("LimitRTPRIO=98", "LimitMEMLOCK=infinity", "RestrictRealtime=no"):
        assert needed in settings
    calls = [line for line in settings if line.startswith("SystemCallFilter=")]
    assert calls[-1] == "SystemCallFilter=sched_setscheduler", "after @resources, which holds it, is taken away"
