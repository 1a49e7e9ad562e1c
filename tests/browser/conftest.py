"""Real arms with simulated boards, the panel, and a browser without a window: Debian's Chromium, driven by Selenium."""

import importlib.util
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from io import BytesIO
from pathlib import Path
from typing import Any, TypeVar

import pytest
from PIL import Image

from hyperbit.controller.panel.access.people import digest_of
from tests import waiting
from tests.endpoints import free_endpoint
from tests.network.played import listening
from tests.system.stack import arms

T = TypeVar("T")

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
OPERATOR, OTHER, VIEWER = "anna-token", "bert-token", "hall-token"
PATIENCE = 180.0  # [s]; software draws the picture, on a machine that others use, too
EVERY = 0.1  # [s] between two looks at the page, each of which takes the browser's time
OPTIONS = (
    *("--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--use-angle=swiftshader"),
    *("--enable-unsafe-swiftshader", "--lang=en", "--force-device-scale-factor=1"),
)


def eventually(what: Callable[[], T], told: Callable[[], str] = lambda: "") -> T:
    return waiting.eventually(what, PATIENCE, told, EVERY)


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

    def __init__(self, folder: Path, closing: ExitStack, *, patient: bool = True) -> None:
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


def acted(act: Callable[[], None]) -> bool:
    """Acts on an element; returns whether it could: the page may draw it anew, hide it or cover it at that moment."""
    from selenium.common import exceptions

    passing = (
        exceptions.StaleElementReferenceException,
        exceptions.ElementNotInteractableException,
        exceptions.ElementClickInterceptedException,
    )
    try:
        act()
    except passing:
        return False
    return True


class Shown:
    def __init__(self, driver: Any, url: str) -> None:
        self.driver, self.url = driver, url

    def visit(self, path: str, token: str, width: int = 1280, height: int = 860, *, dark: bool = False) -> None:
        self.driver.get("about:blank")
        phone = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", phone)
        scheme = [{"name": "prefers-color-scheme", "value": "dark" if dark else "light"}]
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": scheme})
        self.driver.execute_cdp_cmd("Network.clearBrowserCookies", {})
        self.driver.get(f"{self.url}{path}#{token}")

    def one(self, css: str) -> Any:
        """The element of a CSS selector, once it is there."""
        return eventually(lambda: self.all(css), lambda: css)[0]

    def all(self, css: str) -> list[Any]:
        found: list[Any] = self.driver.find_elements("css selector", css)
        return found

    def text(self, css: str) -> str:
        """What an element says, hidden or not."""
        return str(self.run("return document.querySelector(arguments[0])?.textContent ?? ''", css))

    def run(self, script: str, *arguments: object) -> Any:
        return self.driver.execute_script(script, *arguments)

    def says(self, css: str, *words: str) -> str:
        """Waits until an element says all words."""
        told = lambda: f"{words}: {self.text(css)}; notice: {self.text('.notice')}"  # noqa: E731
        eventually(lambda: all(word in self.text(css) for word in words), told)
        return self.text(css)

    def press(self, css: str) -> None:
        def press() -> None:
            eventually(lambda: self.one(css).is_enabled(), lambda: css)
            self.run("arguments[0].scrollIntoView({block: 'center'})", self.one(css))
            self.one(css).click()

        eventually(lambda: acted(press))

    def press_named(self, css: str, name: str) -> None:
        """Clicks on the element of a CSS selector whose text begins with a name."""
        script = (
            "return [...document.querySelectorAll(arguments[0])].find((it) => it.textContent.startsWith(arguments[1]))"
        )

        def press() -> None:
            eventually(lambda: self.run(script, css, name), lambda: name).click()

        eventually(lambda: acted(press))

    def type(self, css: str, text: str) -> None:
        """Types a text into a field, in place of what it has."""
        from selenium.webdriver.common.keys import Keys

        def put() -> None:
            field = self.one(css)
            field.clear()
            field.send_keys(text, Keys.TAB)

        value = "return document.querySelector(arguments[0])?.value"
        eventually(lambda: acted(put) and self.run(value, css) == text, lambda: css)

    def hold(self, css: str, seconds: float = 1.5) -> None:
        from selenium.webdriver import ActionChains

        self.run("arguments[0].scrollIntoView({block: 'center'})", self.one(css))
        ActionChains(self.driver).click_and_hold(self.one(css)).pause(seconds).release().perform()

    def picture(self, name: str) -> None:
        """Keeps a picture of what is shown, in the folder that PICTURES names, if it does."""
        if folder := os.environ.get("PICTURES"):
            (path := Path(folder) / name).parent.mkdir(parents=True, exist_ok=True)
            Image.open(BytesIO(self.driver.get_screenshot_as_png())).convert("RGB").save(path, optimize=True)

    def ready(self) -> None:
        """Waits until the arm is shown and ready, after a stop or a fault of a test before, too."""
        self.says("#reason", " ")
        eventually(lambda: self.run("return document.querySelector('#mode')?.dataset.mode"))
        if self.run("return document.querySelector('#mode').dataset.mode") in ("stopped", "fault"):
            self.hold("#reset")
        self.says("#mode", "ready")
        self.one(".stage canvas")
        eventually(lambda: self.run("return !document.body.classList.contains('old')"))


@pytest.fixture
def page(driver: Any, world: World) -> Iterator[Callable[..., Shown]]:
    """Opens a page of an arm, ready; at the end the browser must have found nothing wrong with it."""
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
    assert wrong == []
