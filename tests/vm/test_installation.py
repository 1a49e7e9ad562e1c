"""install.sh under systemd, without a network: robot.sh upgraded the robot, whose services run and stop here.

The tests run in the order in which they stand, before those of the services.
"""

import subprocess
from importlib.metadata import version
from pathlib import Path

import pytest

from tests.vm.prepare import WHEELS
from tests.vm.robot import EXECUTOR, PLANNER, journal, pid, shown, systemctl

PREFIX = Path("/opt/hyperbit")
PRESENT, IN_PLACE, BESIDE = version("hyperbit"), "0.3", f"{version('hyperbit')}-2"  # folders of versions

pytestmark = pytest.mark.skipif(
    not Path("/etc/systemd/system/tests-of-hyperbit.service").exists(),
    reason="needs the installed services: only in the virtual machine of `make vm-test`",
)


def install(*words: str, folder: Path = WHEELS) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["sh", folder / "install.sh", *words], capture_output=True, text=True)


def present() -> str:
    return (PREFIX / "current").resolve().name


def versions() -> set[str]:
    return {path.name for path in (PREFIX / "versions").iterdir()}


def start(*services: str) -> None:
    """Starts services, whose processes must be those of the present version."""
    systemctl("start", *services)
    for service in services:
        assert shown(service, "ActiveState") == "active", journal()
        assert Path(f"/proc/{pid(service)}/cmdline").read_text().startswith(f"{PREFIX}/versions/{present()}/bin/python")


def stop() -> None:
    systemctl("stop", PLANNER, EXECUTOR)


def test_upgrade_of_a_virtual_environment_without_a_folder_keeps_it() -> None:
    assert (present(), (PREFIX / "previous").resolve().name, versions()) == (PRESENT, IN_PLACE, {PRESENT, IN_PLACE})
    for link in ("bin/hyperbit", "doc/deploy/README.md"):
        assert (PREFIX / link).resolve().is_relative_to(PREFIX / "versions" / PRESENT)


def test_installation_that_fails_leaves_the_services_running_and_enabled(tmp_path: Path) -> None:
    start(PLANNER, EXECUTOR)
    processes = pid(PLANNER), pid(EXECUTOR)
    for file in WHEELS.iterdir():
        if not file.name.startswith("numpy-"):
            (tmp_path / file.name).symlink_to(file)
    done = install(folder=tmp_path)
    assert "No matching distribution found for numpy" in done.stderr
    assert f"install: failed; no service has changed, and {PREFIX}/versions/{PRESENT} is in use" in done.stderr
    small = f"mount -t tmpfs -o size=50m tmpfs {PREFIX}/versions && exec sh {WHEELS}/install.sh"
    full = subprocess.run(["unshare", "--mount", "sh", "-c", small], capture_output=True, text=True)
    assert "has 50 MB of free disk, and an installation needs" in full.stderr
    assert (done.returncode, full.returncode) == (1, 1)
    assert (present(), versions()) == (PRESENT, {PRESENT, IN_PLACE})
    assert (pid(PLANNER), pid(EXECUTOR)) == processes
    assert systemctl("is-enabled", PLANNER).strip() == "enabled"


def test_way_back_waits_for_the_end_of_the_services_and_leads_forward_again() -> None:
    refused = install("--back")
    assert (refused.returncode, present()) == (1, PRESENT)
    assert f"install: services are running: systemctl stop {EXECUTOR}.service {PLANNER}.service" in refused.stderr
    stop()
    for expected in (IN_PLACE, PRESENT):
        done = install("--back")
        assert done.returncode == 0, done.stderr
        assert present() == expected
        start(EXECUTOR)
        stop()


def test_upgrade_beside_running_services_waits_for_the_switch() -> None:
    start(PLANNER, EXECUTOR)
    processes = pid(PLANNER), pid(EXECUTOR)
    done = install("--without", "panel,pictures")
    assert done.returncode == 0, done.stderr
    assert f"{PREFIX}/versions/{BESIDE} is complete, and {PREFIX}/versions/{PRESENT} stays in use" in done.stdout
    assert (present(), pid(PLANNER), pid(EXECUTOR)) == (PRESENT, *processes)
    assert install("--switch").returncode == 1
    stop()
    done = install("--switch")
    assert done.returncode == 0, done.stderr
    assert f"removed {PREFIX}/versions/{IN_PLACE}\n" in done.stdout
    assert (present(), versions()) == (BESIDE, {BESIDE, PRESENT})
    assert not Path("/etc/systemd/system/hyperbit-panel.service").exists()
    start(PLANNER, EXECUTOR)
    stop()
