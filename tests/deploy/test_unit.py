"""The two units as systemd sees them, without a running systemd."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.keys import DEPLOY

EXPOSURE = {"hyperbit-executor": 1.2, "hyperbit": 1.6}  # greatest allowed, of `systemd-analyze security`
UNITS = {name: DEPLOY / f"{name}.service" for name in EXPOSURE}

analyzed = pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is missing")


def settings(unit: Path) -> dict[str, list[str]]:
    """Returns the values of each setting of a unit, in order."""
    found: dict[str, list[str]] = {}
    for line in unit.read_text().splitlines():
        if "=" in line and not line.startswith("#"):
            name, _, value = line.partition("=")
            found.setdefault(name, []).append(value)
    return found


def analyze(*words: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["systemd-analyze", *words], capture_output=True, text=True)


@analyzed
@pytest.mark.parametrize("name", UNITS)
def test_exposure_is_bounded(name: str) -> None:
    ended = analyze("security", "--no-pager", "--offline=true", UNITS[name])
    exposure = re.search(rf"exposure level for {name}\.service: ([0-9.]+)", ended.stdout)
    assert exposure, ended.stdout + ended.stderr
    assert float(exposure[1]) <= EXPOSURE[name], ended.stdout


@analyzed
def test_no_setting_is_unknown_to_systemd() -> None:
    ended = analyze("verify", *UNITS.values())
    lines = [line for line in ended.stderr.splitlines() if "hyperbit" in line]
    assert [line for line in lines if "is not executable" not in line] == []  # the program is not installed here


def test_executor_reaches_can_and_local_sockets_only() -> None:
    executor = settings(UNITS["hyperbit-executor"])
    assert executor["RestrictAddressFamilies"] == ["AF_UNIX AF_CAN"]
    assert executor["IPAddressDeny"] == ["any"]
    assert "PrivateNetwork" not in executor, "it would hide the CAN interface"


def test_planner_does_not_reach_can() -> None:
    (families,) = settings(UNITS["hyperbit"])["RestrictAddressFamilies"]
    assert "AF_CAN" not in families
    assert "AF_PACKET" not in families


def test_executor_creates_no_machine_code() -> None:
    assert settings(UNITS["hyperbit-executor"])["MemoryDenyWriteExecute"] == ["yes"]


def test_systemd_grants_the_executor_real_time_and_the_program_cannot_raise_it() -> None:
    executor = settings(UNITS["hyperbit-executor"])
    assert (executor["CPUSchedulingPolicy"], executor["CPUSchedulingPriority"]) == (["fifo"], ["50"])
    assert executor["CPUSchedulingResetOnFork"] == executor["RestrictRealtime"] == ["yes"]
    assert executor["LimitMEMLOCK"] == ["infinity"]
    assert executor["SystemCallFilter"][-1] == "~@privileged @resources", "which includes sched_setscheduler"


def test_planner_has_no_real_time() -> None:
    planner = settings(UNITS["hyperbit"])
    assert planner["RestrictRealtime"] == ["yes"]
    assert not {"CPUSchedulingPolicy", "LimitRTPRIO", "LimitMEMLOCK"} & planner.keys()


def test_planner_starts_the_executor_but_lives_without_it() -> None:
    planner, executor = settings(UNITS["hyperbit"]), settings(UNITS["hyperbit-executor"])
    assert "hyperbit-executor.service" in planner["Wants"][0].split()
    assert "hyperbit-executor.service" in planner["After"][0].split()
    binding = {"Requires", "Requisite", "BindsTo", "PartOf", "Upholds", "PropagatesStopTo", "StopPropagatedFrom"}
    assert not binding & (planner.keys() | executor.keys())


def test_users_are_separate_and_share_the_sockets_group() -> None:
    planner, executor = settings(UNITS["hyperbit"]), settings(UNITS["hyperbit-executor"])
    assert planner["DynamicUser"] == executor["DynamicUser"] == ["yes"]
    assert planner["Group"] == executor["Group"] == ["hyperbit"]
    assert planner["User"] != ["hyperbit"], "systemd refuses a transient user with the name of a static group"
    assert planner["StateDirectory"] != executor["StateDirectory"]
    assert (executor["RuntimeDirectory"], executor["RuntimeDirectoryMode"]) == (["hyperbit"], ["0750"])
    assert "RuntimeDirectoryPreserve" not in executor, "it would hide the socket in /run/private"
    assert all("--socket /run/hyperbit" in unit["ExecStart"][0] for unit in (planner, executor))


@pytest.mark.parametrize("name", UNITS)
def test_service_is_watched_and_restarted(name: str) -> None:
    unit = settings(UNITS[name])
    assert (unit["Type"], unit["Restart"], unit["StartLimitIntervalSec"]) == (["notify"], ["always"], ["0"])
    assert 0 < int(unit["WatchdogSec"][0]) <= 10
