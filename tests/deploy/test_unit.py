"""The units, checked by systemd's tools without a running systemd."""

import re
import shutil
import subprocess
from fnmatch import fnmatch
from pathlib import Path

import pytest

from tests.keys import DEPLOY

EXPOSURE = {  # greatest exposure allowed, of `systemd-analyze security`
    "hyperbit-executor@": 1.2,
    "hyperbit@": 1.6,
    "hyperbit-panel": 1.5,
    "hyperbit-recorder": 1.5,
    "hyperbit-ros2": 1.2,
    "hyperbit-router": 1.5,
}
UNITS = {name: DEPLOY / f"{name}.service" for name in EXPOSURE}
OPTIONAL = ("hyperbit-panel", "hyperbit-recorder", "hyperbit-ros2", "hyperbit-router")
LOOPBACK = {"IPAddressDeny": "any", "IPAddressAllow": "localhost"}
SETTINGS: dict[str, dict[str, str]] = {
    "hyperbit-executor@": {
        "RestrictAddressFamilies": "AF_UNIX AF_CAN",
        "IPAddressDeny": "any",
        "MemoryDenyWriteExecute": "yes",
        "CPUSchedulingPolicy": "fifo",
        "CPUSchedulingPriority": "50",
        "CPUSchedulingResetOnFork": "yes",
        "RestrictRealtime": "yes",
        "LimitMEMLOCK": "infinity",
        "SystemCallFilter": "~@privileged @resources",  # the last one; it includes sched_setscheduler
        "DynamicUser": "yes",
        "Group": "hyperbit",
        "RuntimeDirectory": "hyperbit-arms/%i",
        "RuntimeDirectoryMode": "0750",
        "FileDescriptorStoreMax": "1",  # for the switch journal
    },
    "hyperbit@": {"RestrictRealtime": "yes", "DynamicUser": "yes", "Group": "hyperbit"},
    "hyperbit-panel": {
        "DynamicUser": "yes",
        "RuntimeDirectoryPreserve": "yes",  # sessions outlive the service, but not the computer's clock
    },
    "hyperbit-recorder": {**LOOPBACK, "MemoryDenyWriteExecute": "yes"},
    "hyperbit-ros2": {**LOOPBACK, "StateDirectory": "hyperbit-ros2"},  # the goals of action clients outlive it
    "hyperbit-router": {"MemoryDenyWriteExecute": "yes"},
}
BINDING = {"Requires", "Requisite", "BindsTo", "PartOf", "Upholds", "PropagatesStopTo", "StopPropagatedFrom"}
ABSENT = {
    "hyperbit-executor@": {
        *BINDING,  # the planner lives without it
        "PrivateNetwork",  # it would hide the CAN interface
        "RuntimeDirectoryPreserve",  # it would hide the socket in /run/private
        *("TasksMax", "LimitNPROC", "KillMode"),  # the copier may start; SIGTERM to all, SIGKILL after a time
    },
    "hyperbit@": {*BINDING, "CPUSchedulingPolicy", "LimitRTPRIO", "LimitMEMLOCK"},
    "hyperbit-router": {"StateDirectory", "CacheDirectory"},  # it keeps nothing
}

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
def test_no_setting_is_unknown_to_systemd(tmp_path: Path) -> None:
    for name in ("hyperbit-executor@", "hyperbit@"):
        (tmp_path / f"{name}left.service").write_text(UNITS[name].read_text())
    for units in (UNITS.values(), [tmp_path / "hyperbit@left.service"]):
        lines = [line for line in analyze("verify", *units).stderr.splitlines() if "hyperbit" in line]
        assert [line for line in lines if "is not executable" not in line] == []  # the program is not installed here


@pytest.mark.parametrize("name", UNITS)
def test_a_unit_has_its_settings_is_watched_and_restarted(name: str) -> None:
    unit = settings(UNITS[name])
    common = {"Type": "notify", "Restart": "always", "StartLimitIntervalSec": "0"}
    assert {key: unit[key][-1] for key in common | SETTINGS[name]} == common | SETTINGS[name]
    assert not ABSENT.get(name, set()) & unit.keys()
    assert "MemoryMax" in unit
    assert 0 < int(unit["WatchdogSec"][0]) <= 10
    if name != "hyperbit-executor@":
        assert not {"AF_CAN", "AF_PACKET"} & {*unit["RestrictAddressFamilies"][0].split()}


@pytest.mark.parametrize("name", OPTIONAL)
def test_an_optional_service_is_off_at_first_and_cannot_open_the_executors_socket(name: str) -> None:
    install = (DEPLOY / "install.sh").read_text()
    assert name in install
    assert f"enable {name}" not in install.replace("--now ", "")
    assert "Group" not in settings(UNITS[name])


def test_commands_of_services_have_their_options() -> None:
    panel, recorder, router = (settings(UNITS[f"hyperbit-{name}"]) for name in ("panel", "recorder", "router"))
    assert "--people" in panel["ExecStart"][0]
    assert "--listen" not in panel["ExecStart"][0], "the loopback interface, as long as nobody asks for another"
    assert "--keep" in recorder["ExecStart"][0], "recordings must not fill the disk"
    assert all(f"hyperbit.{part}.pem" in router["LoadCredential"] for part in ("ca", "certificate", "key"))
    file = (DEPLOY / "zenoh-router.json5").read_text()
    assert file.count("/run/credentials/hyperbit-router.service/hyperbit.") == 3


def test_planner_starts_the_executor_whose_copier_has_time_for_a_last_copy() -> None:
    planner, executor = settings(UNITS["hyperbit@"]), settings(UNITS["hyperbit-executor@"])
    for setting in ("Wants", "After"):
        assert "hyperbit-executor@%i.service" in planner[setting][0].split()
    assert "@process" not in " ".join(executor["SystemCallFilter"]), "which includes vfork and execve"
    assert int(executor["TimeoutStopSec"][0]) >= 10


def test_instances_share_no_folder_and_no_user() -> None:
    planner, executor = settings(UNITS["hyperbit@"]), settings(UNITS["hyperbit-executor@"])
    for unit in (planner, executor):
        assert "/etc/hyperbit/%i.yaml --socket /run/hyperbit-arms/%i" in unit["ExecStart"][0]
        assert unit["User"][0].endswith("-%i")
        assert len(unit["User"][0]) - len("%i") + 19 <= 31, "systemd takes names of users of 31 characters"
    assert planner["StateDirectory"] != executor["StateDirectory"]


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
