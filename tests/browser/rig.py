"""A page in the browser, and words for what an operator does with it."""

import os
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import pytest
from PIL import Image

from tests import waiting

if TYPE_CHECKING:
    from tests.browser.conftest import Trouble

T = TypeVar("T")

OPERATOR, OTHER, VIEWER = "anna-token", "bert-token", "hall-token"
PATIENCE = 180.0  # [s]; software draws the picture, on a machine that others use, too
EVERY = 0.1  # [s] between two looks at the page, each of which takes the browser's time
AXE = Path(__file__).parents[2] / ".venv/axe.min.js"  # from npm; make page-test gets it
FIND = """
const done = arguments[0];
const said = ({ id, nodes }) => `${id}: ${nodes.map((node) => node.html).slice(0, 3)}`;
axe.run(document, { resultTypes: ["violations"] })
  .then(({ violations }) => done(violations.map(said)), (error) => done([String(error)]));
"""
DRAWN = """
const canvas = document.querySelector('.stage canvas');
const data = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
const [r, g, b] = arguments[0];
let count = 0;
for (let k = 0; k < data.length; k += 4) {
  const away = Math.abs(data[k] - r) + Math.abs(data[k + 1] - g) + Math.abs(data[k + 2] - b);
  if (away < 90 && data[k + 3] > 200) count += 1;
}
return count;
"""
MEASURED, PLANNED, OBSTACLE = [0, 114, 178], [0, 120, 90], [138, 75, 114]  # light colours of style.css
UNKNOWN, BAD = [163, 25, 91], [176, 0, 32]
COUNT = 48  # actuators
FAULT: dict[str, Any] = {
    "mode": "fault",
    "reason": "can0/1 is silent",
    "configuration": None,
    "tip": None,
    "commanded": None,
}


def eventually(what: Callable[[], T], told: Callable[[], str] = lambda: "") -> T:
    return waiting.eventually(what, PATIENCE, told, EVERY)


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


def type_goal(shown: Shown, *numbers: float) -> None:
    for k, number in enumerate(numbers, 1):
        shown.type(f"#goal .fields label:nth-child({k}) input", f"{number:g}")


def opened(trouble: "Trouble", driver: object, **fields: Any) -> Shown:
    shown = Shown(driver, trouble.url)
    shown.visit("/arms/planar16", OPERATOR)
    shown.one(".stage canvas")
    told(trouble, shown, **fields)
    return shown


def told(trouble: "Trouble", shown: Shown, **fields: Any) -> None:
    """Publishes a state until the page shows it."""
    reason = fields.get("reason", "holding")

    def heard() -> bool:
        trouble.daemon.state(**fields)
        return shown.text("#reason") == reason

    eventually(heard, lambda: shown.text("header"))


def planned(trouble: "Trouble", driver: object) -> Shown:
    trouble.daemon.gate.set()
    shown = opened(trouble, driver, reason="planned")
    type_goal(shown, 0.4, 2.9)
    shown.says("#goal .plan", "switches")
    eventually(lambda: enabled(shown))
    return shown


def enabled(shown: Shown) -> bool:
    return bool(shown.one("#go").is_enabled())


def found(shown: Shown) -> list[str]:
    if not AXE.exists():
        pytest.skip("axe is not installed: make page-test gets it from npm")
    shown.run(AXE.read_text() + "; window.axe = axe;")
    wrong: list[str] = shown.driver.execute_async_script(FIND)
    return wrong
