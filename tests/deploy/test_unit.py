"""The units, checked by systemd's tools without a running systemd."""

import re
import shutil
import subprocess
from fnmatch import fnmatch
from pathlib import Path

import pytest

from tests.keys import DEPLOY

EXECUTOR, PLANNER, PANEL, RECORDER, ROS2, ROUTER = (
    1.2,
    1.6,
    1.5,
    1.5,
    1.2,
    1.5,
)  # greatest exposure allowed, of `systemd-analyze security`
EXPOSURE = {
    "hyperbit-executor@": EXECUTOR,
    "hyperbit@": PLANNER,
    "hyperbit-panel": PANEL,
    "hyperbit-recorder": RECORDER,
    "hyperbit-ros2": ROS2,
    "hyperbit-router": ROUTER,
}
UNITS = {name: DEPLOY / f"{name}.service" for name in EXPOSURE}

analyzed = pytest.mark.skipif(shutil.which("systemd-analyze") is None, reason="systemd-analyze is missing")


def settings(unit: Path) -> dict[str, list[str]]:
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
    exposure = re.search(rf"exposure level for {name}[^ ]*\.service: ([0-9.]+)", ended.stdout)
    assert exposure, ended.stdout + ended.stderr
    assert float(exposure[1]) <= EXPOSURE[name], ended.stdout


@analyzed
def test_no_setting_is_unknown_to_systemd() -> None:
    ended = analyze("verify", *UNITS.values())
    lines = [line for line in ended.stderr.splitlines() if "hyperbit" in line]
    assert [line for line in lines if "is not executable" not in line] == []  # the program is not installed here


@pytest.mark.parametrize("name", UNITS)
def test_memory_is_limited(name: str) -> None:
    assert "MemoryMax" in settings(UNITS[name])


def test_executor_reaches_can_and_local_sockets_only() -> None:
    executor = settings(UNITS["hyperbit-executor@"])
    assert executor["RestrictAddressFamilies"] == ["AF_UNIX AF_CAN"]
    assert executor["IPAddressDeny"] == ["any"]
    assert "PrivateNetwork" not in executor, "it would hide the CAN interface"


def test_planner_does_not_reach_can() -> None:
    (families,) = settings(UNITS["hyperbit@"])["RestrictAddressFamilies"]
    assert "AF_CAN" not in families
    assert "AF_PACKET" not in families


def test_executor_creates_no_machine_code() -> None:
    assert settings(UNITS["hyperbit-executor@"])["MemoryDenyWriteExecute"] == ["yes"]


def test_systemd_grants_the_executor_real_time_and_the_program_cannot_raise_it() -> None:
    executor = settings(UNITS["hyperbit-executor@"])
    assert (executor["CPUSchedulingPolicy"], executor["CPUSchedulingPriority"]) == (["fifo"], ["50"])
    assert executor["CPUSchedulingResetOnFork"] == executor["RestrictRealtime"] == ["yes"]
    assert executor["LimitMEMLOCK"] == ["infinity"]
    assert executor["SystemCallFilter"][-1] == "~@privileged @resources", "which includes sched_setscheduler"


def test_the_executors_copier_may_start_and_has_time_for_a_last_copy() -> None:
    executor = settings(UNITS["hyperbit-executor@"])
    assert not {"TasksMax", "LimitNPROC", "KillMode"} & executor.keys(), "SIGTERM to all, SIGKILL after a time"
    assert "@process" not in " ".join(executor["SystemCallFilter"]), "which includes vfork and execve"
    assert int(executor["TimeoutStopSec"][0]) >= 10


def test_planner_has_no_real_time() -> None:
    planner = settings(UNITS["hyperbit@"])
    assert planner["RestrictRealtime"] == ["yes"]
    assert not {"CPUSchedulingPolicy", "LimitRTPRIO", "LimitMEMLOCK"} & planner.keys()


def test_planner_starts_the_executor_but_lives_without_it() -> None:
    planner, executor = settings(UNITS["hyperbit@"]), settings(UNITS["hyperbit-executor@"])
    assert "hyperbit-executor@%i.service" in planner["Wants"][0].split()
    assert "hyperbit-executor@%i.service" in planner["After"][0].split()
    binding = {"Requires", "Requisite", "BindsTo", "PartOf", "Upholds", "PropagatesStopTo", "StopPropagatedFrom"}
    assert not binding & (planner.keys() | executor.keys())


def test_users_are_separate_and_share_the_sockets_group() -> None:
    planner, executor = settings(UNITS["hyperbit@"]), settings(UNITS["hyperbit-executor@"])
    assert planner["DynamicUser"] == executor["DynamicUser"] == ["yes"]
    assert planner["Group"] == executor["Group"] == ["hyperbit"]
    assert executor["RuntimeDirectoryMode"] == ["0750"]
    assert "RuntimeDirectoryPreserve" not in executor, "it would hide the socket in /run/private"
    assert executor["FileDescriptorStoreMax"] == ["1"], "for the switch journal"


@pytest.mark.parametrize("name", UNITS)
def test_service_is_watched_and_restarted(name: str) -> None:
    unit = settings(UNITS[name])
    assert (unit["Type"], unit["Restart"], unit["StartLimitIntervalSec"]) == (["notify"], ["always"], ["0"])
    assert 0 < int(unit["WatchdogSec"][0]) <= 10


def test_the_panel_is_off_at_first_and_reaches_no_can() -> None:
    panel = settings(UNITS["hyperbit-panel"])
    install = (DEPLOY / "install.sh").read_text()
    assert "hyperbit-panel" in install
    assert "enable hyperbit-panel" not in install.replace("--now ", "")
    assert "AF_CAN" not in panel["RestrictAddressFamilies"][0]
    assert panel["DynamicUser"] == ["yes"]
    assert panel["RuntimeDirectoryPreserve"] == ["yes"], "sessions outlive the service, but not the computer's clock"
    assert "Group" not in panel, "the executor's socket is not for it"
    assert "--people" in panel["ExecStart"][0]
    assert "--listen" not in panel["ExecStart"][0], "the loopback interface, as long as nobody asks for another"


@pytest.mark.parametrize("name", ["hyperbit-recorder", "hyperbit-ros2"])
def test_recorder_and_bridge_are_off_at_first_and_reach_this_computer_only(name: str) -> None:
    unit, install = settings(UNITS[name]), (DEPLOY / "install.sh").read_text()
    assert name in install
    assert f"enable {name}" not in install.replace("--now ", "")
    assert (unit["IPAddressDeny"], unit["IPAddressAllow"]) == (["any"], ["localhost"])
    assert "AF_CAN" not in unit["RestrictAddressFamilies"][0]
    assert "Group" not in unit, "the executor's socket is not for it"
    if name == "hyperbit-ros2":
        assert unit["StateDirectory"] == ["hyperbit-ros2"], "the goals of action clients outlive it"
    else:
        assert unit["MemoryDenyWriteExecute"] == ["yes"]
        assert "--keep" in unit["ExecStart"][0], "recordings must not fill the disk"


def test_the_router_is_off_at_first_and_reaches_networks_only() -> None:
    router, install = settings(UNITS["hyperbit-router"]), (DEPLOY / "install.sh").read_text()
    assert "hyperbit-router" in install
    assert "enable hyperbit-router" not in install.replace("--now ", "")
    assert "AF_CAN" not in router["RestrictAddressFamilies"][0]
    assert "Group" not in router, "the executor's socket is not for it"
    assert router["MemoryDenyWriteExecute"] == ["yes"]
    assert not {"StateDirectory", "CacheDirectory"} & router.keys(), "it keeps nothing"
    assert all(f"hyperbit.{part}.pem" in router["LoadCredential"] for part in ("ca", "certificate", "key"))
    file = (DEPLOY / "zenoh-router.json5").read_text()
    assert file.count("/run/credentials/hyperbit-router.service/hyperbit.") == 3


def test_instances_share_no_folder_and_no_user() -> None:
    planner, executor = settings(UNITS["hyperbit@"]), settings(UNITS["hyperbit-executor@"])
    for unit in (planner, executor):
        assert "/etc/hyperbit/%i.yaml --socket /run/hyperbit-arms/%i" in unit["ExecStart"][0]
        assert unit["User"][0].endswith("-%i")
        assert len(unit["User"][0]) - len("%i") + 19 <= 31, "systemd takes names of users of 31 characters"
    assert executor["RuntimeDirectory"] == ["hyperbit-arms/%i"]
    assert planner["StateDirectory"] != executor["StateDirectory"]


@analyzed
def test_an_instance_has_no_setting_that_is_unknown_to_systemd(tmp_path: Path) -> None:
    for name in ("hyperbit-executor@", "hyperbit@"):
        (tmp_path / f"{name}left.service").write_text(UNITS[name].read_text())
    ended = analyze("verify", tmp_path / "hyperbit@left.service")
    lines = [line for line in ended.stderr.splitlines() if "hyperbit" in line]
    assert [line for line in lines if "is not executable" not in line] == []


def test_the_rules_for_adapters_are_whole() -> None:
    rules = [line for line in (DEPLOY / "70-hyperbit-can.rules").read_text().splitlines() if not line.startswith("#")]
    network = settings(DEPLOY / "can0.network")["Name"][0].split()
    for rule in rules:
        matches = dict(
            re.fullmatch(r'([A-Z]+(?:\{\w+\})?)(==|=)"([^"]+)"', part).group(1, 3) for part in rule.split(", ")
        )
        assert {"SUBSYSTEM", "ACTION", "ATTRS{serial}", "NAME"} <= matches.keys()
        assert len(matches["NAME"]) <= 15
        assert any(fnmatch(matches["NAME"], pattern) for pattern in network)
    assert len(rules) == 3


def test_the_page_removes_all_services() -> None:
    text = (DEPLOY / "README.md").read_text().partition("## Remove")[2].partition("```\n\n")[0]
    assert "systemctl stop 'hyperbit*'" in text
    (disabled,) = [line for line in text.splitlines() if "systemctl disable" in line]
    enabled = {path.stem for path in DEPLOY.glob("*.service") if "[Install]" in path.read_text().splitlines()}
    assert enabled <= set(disabled.split())
