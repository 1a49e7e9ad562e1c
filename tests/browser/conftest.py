"""Real arms with simulated boards, the panel, and a browser without a window: Debian's Chromium, driven by Selenium."""

import importlib.util
import os
import shutil
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from hyperbit.controller.panel.access.people import digest_of
from tests.browser.rig import OPERATOR, OTHER, PATIENCE, VIEWER, Shown, eventually
from tests.endpoints import free_endpoint
from tests.network.played import listening
from tests.system.stack import arms

# A panel that refuses no command for its age, however slow the browser is on this machine.
PATIENT_PANEL = """
from hyperbit.controller.cli import main
from hyperbit.controller.panel.arms import heartbeats
heartbeats.LONGEST = 3600.0
main()
"""

MISSING = shutil.which("chromium") is None or importlib.util.find_spec("selenium") is None
collect_ignore_glob = ["test_*.py"] if MISSING else []

ROOT = Path(__file__).parents[2]
OPTIONS = (
    *("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--use-angle=swiftshader"),
    *("--enable-unsafe-swiftshader", "--lang=en", "--force-device-scale-factor=1"),
)


class World:
    """The arms `flat`, in the plane, and `mixed`, in space, and the panel that shows both.

    Args:
        slow: fields of the file of a third arm, `slow`, in the plane; none: there is no such arm.
    """

    def __init__(self, folder: Path, closing: ExitStack, slow: dict[str, Any] | None = None) -> None:
        self.planners: dict[str, subprocess.Popen[str]] = {}
        self.endpoints: dict[str, str] = {}
        self._folder, self._closing = folder, closing
        for kind, name, fields in (("planar", "flat", {}), ("mixed", "mixed", {}), ("planar", "slow", slow)):
            if fields is None:
                continue
            own = self.folder(name)
            arms.write(own, kind, name, {"channel": "can0"}, fields)
            self.endpoints[name] = free_endpoint()
            command = ["run", str(own / "arm.yaml"), "--simulate", "--listen", self.endpoints[name]]
            self.planners[name] = self.start(command, own)
        people = [
            f"{{name: {name}, role: {role}, token: {digest_of(token)}}}"
            for name, role, token in (
                ("anna", "operator", OPERATOR),
                ("bert", "operator", OTHER),
                ("hall", "viewer", VIEWER),
            )
        ]
        (folder / "people.yaml").write_text(f"people: [{', '.join(people)}]\n")
        self.url = self.panel("panel", *self.endpoints.values())

    def folder(self, name: str) -> Path:
        folder = self._folder / name
        folder.mkdir()
        return folder

    def start(self, words: list[str], folder: Path) -> subprocess.Popen[str]:
        return started(words, folder, self._closing)

    def panel(self, name: str, *endpoints: str, prefix: str = "hyperbit") -> str:
        folder = self.folder(name)
        words = ["panel", "--listen", "127.0.0.1:0", "--people", str(self._folder / "people.yaml"), "--prefix", prefix]
        self.start([*words, *(word for endpoint in endpoints for word in ("--connect", endpoint))], folder)
        begin = "hyperbit panel, "
        line = eventually(lambda: [x for x in (folder / "log").read_text().splitlines() if x.startswith(begin)])[0]
        return line.removeprefix(begin).rstrip("/")


class Trouble:
    """A fake daemon and a panel in its own process.

    Args:
        patient: whether the panel refuses no command for its age.
    """

    def __init__(self, folder: Path, closing: ExitStack, endpoint: str = "", *, patient: bool = True) -> None:
        if not endpoint:
            endpoint = free_endpoint()
            self.daemon = listening(closing, endpoint)
        people = folder / "people.yaml"
        listed = (("anna", "operator", OPERATOR), ("hall", "viewer", VIEWER))
        entries = [f"{{name: {name}, role: {role}, token: {digest_of(token)}}}" for name, role, token in listed]
        people.write_text(f"people: [{', '.join(entries)}]\n")
        words = ["panel", "--listen", "127.0.0.1:0", "--people", str(people), "--connect", endpoint]
        started(words, folder, closing, patient=patient)
        begin, log = "hyperbit panel, ", folder / "log"
        line = eventually(lambda: [x for x in log.read_text().splitlines() if x.startswith(begin)])[0]
        self.url = line.removeprefix(begin).rstrip("/")


@pytest.fixture(scope="session")
def trouble(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Trouble]:
    with ExitStack() as closing:
        yield Trouble(tmp_path_factory.mktemp("trouble"), closing)


def started(words: list[str], folder: Path, closing: ExitStack, *, patient: bool = True) -> subprocess.Popen[str]:
    environment = {**os.environ, "RUNTIME_DIRECTORY": str(folder), "STATE_DIRECTORY": str(folder)}
    log = closing.enter_context((folder / "log").open("w"))
    program = ["-c", PATIENT_PANEL] if words[0] == "panel" and patient else ["-m", "hyperbit"]
    process = subprocess.Popen(
        [sys.executable, *program, *words], cwd=ROOT, env=environment, stdout=log, stderr=log, text=True
    )

    def end() -> None:
        process.send_signal(signal.SIGCONT)
        process.terminate()
        try:
            process.wait(30)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

    closing.callback(end)
    return process


@pytest.fixture(scope="session")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[World]:
    with ExitStack() as closing:
        yield World(tmp_path_factory.mktemp("page"), closing)


@pytest.fixture(scope="session")
def driver() -> Iterator[Any]:
    from selenium import webdriver

    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium") or ""
    for word in OPTIONS:
        options.add_argument(word)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    browser = webdriver.Chrome(options=options, service=webdriver.ChromeService(shutil.which("chromedriver")))
    browser.set_script_timeout(PATIENCE)
    yield browser
    browser.quit()


@pytest.fixture
def page(driver: Any, world: World) -> Iterator[Callable[..., Shown]]:
    """Opens a page of an arm, ready; at the end the browser must have found nothing wrong with it."""
    driver.get("about:blank")
    driver.get_log("browser")  # what another test's page said, whose server has ended, is not of this one
    shown = Shown(driver, world.url)

    def visit(
        arm: str = "flat", token: str = OPERATOR, width: int = 1280, height: int = 860, *, dark: bool = False
    ) -> Shown:
        shown.visit(f"/arms/{arm}", token, width, height, dark=dark)
        if token != VIEWER:
            shown.ready()
        return shown

    yield visit
    wrong = [entry["message"] for entry in driver.get_log("browser") if entry["level"] == "SEVERE"]
    driver.get("about:blank")  # no page outlives its server
    assert wrong == []


@pytest.fixture
def heard(trouble: Trouble) -> Iterator[None]:
    """The daemon repeats its latest state, so that the arm is not silent."""
    ended = threading.Event()

    def repeat() -> None:
        while not ended.wait(0.3):
            trouble.daemon.repeat()

    thread = threading.Thread(target=repeat)
    thread.start()
    yield
    ended.set()
    thread.join()
