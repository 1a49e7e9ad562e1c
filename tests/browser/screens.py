"""Pictures of the page in each of its states: 1280, 768 and 360 pixels wide, light and dark.

python -m tests.browser.screens FOLDER [STATE ...]

The arms are played. A file is named by state, width and colours. It shows the first screen; on a phone the whole page,
in columns.
"""

import sys
import tempfile
from base64 import b64decode
from collections.abc import Callable
from contextlib import ExitStack, contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

from PIL import Image

from tests import told
from tests.browser.conftest import Trouble, driver
from tests.browser.rig import OPERATOR, Shown, eventually, type_goal
from tests.network.played import PlayedArm, Router

SIZES = ((1280, 860), (768, 1024), (360, 740))
COLUMN = 1480  # [pixels], two screens of a phone
AWAY = [int(k % 3 == 0) for k in range(48)]
LOCKED = [{"actuator": name, "state": k % 2} for k, name in enumerate(("3.left", "7.diagonal", "12.right"))]
FAULT = {"mode": "fault", "reason": told.FAULT["message"], "faults": [told.FAULT], "configuration": None, "tip": None}
MOVING = {"mode": "executing", "reason": "to the goal pick-7", "goal": "pick-7", "commanded": AWAY}
STOPPED = {"mode": "stopped", "reason": "stopped by anna"}
MODES = ({}, {}, MOVING, {}, STOPPED, FAULT, {})  # of the twenty arms, in turn


def plan(shown: Shown) -> None:
    type_goal(shown, 0.9, 2.6)
    shown.says("#goal .plan", "switches")
    eventually(lambda: shown.one("#go").is_enabled())


# Fields of the arm's state, and what an operator does then.
STATES: dict[str, tuple[dict[str, Any], Callable[[Shown], None] | None]] = {
    "idle": ({}, None),
    "planned": ({}, plan),
    "moving": (MOVING, None),
    "fault": (FAULT, None),
    "stopped": (STOPPED, None),
    "locked": ({"degraded": LOCKED}, None),
}


def take(shown: Shown, folder: Path, state: str, path: str, prepare: Callable[[Shown], None]) -> None:
    """Takes six pictures of a state; `prepare` brings the page there."""
    for width, height in SIZES:
        for dark in (False, True):
            shown.visit(path, OPERATOR, width, height, dark=dark)
            prepare(shown)
            shown.run("window.scrollTo(0, 0)")
            picture = whole(shown) if width < 600 else Image.open(BytesIO(shown.driver.get_screenshot_as_png()))
            name = f"{state}-{width}-{'dark' if dark else 'light'}.png"
            picture.convert("RGB").save(folder / name, optimize=True)
    print(state, flush=True)


def whole(shown: Shown) -> Image.Image:
    taken = shown.driver.execute_cdp_cmd("Page.captureScreenshot", {"captureBeyondViewport": True})
    page = Image.open(BytesIO(b64decode(taken["data"]))).convert("RGB")
    columns = -(-page.height // COLUMN)
    result = Image.new("RGB", (columns * (page.width + 20) - 20, min(page.height, COLUMN)), "gray")
    for k in range(columns):
        part = page.crop((0, k * COLUMN, page.width, min(page.height, (k + 1) * COLUMN)))
        result.paste(part, (k * (page.width + 20), 0))
    return result


def take_arm(trouble: Trouble, shown: Shown, folder: Path, name: str) -> None:
    def prepare(shown: Shown) -> None:
        fields, more = STATES[name]
        reason = fields.get("reason", "holding")
        eventually(lambda: trouble.daemon.state(**fields) and shown.text("#reason") == reason)
        shown.one(".stage canvas")
        if more is not None:
            more(shown)
        trouble.daemon.repeat()

    take(shown, folder, name, "/arms/planar16", prepare)


def take_list(shown: Shown, folder: Path, arms: list[PlayedArm]) -> None:
    def prepare(shown: Shown) -> None:
        for k, arm in enumerate(arms):
            arm.state(**MODES[k % len(MODES)])
        eventually(lambda: shown.run("return document.body.innerText.split('arm').length") > len(arms))
        eventually(lambda: "fault" in shown.run("return document.body.innerText"))

    take(shown, folder, "list", "/", prepare)


def main() -> None:
    """Takes the pictures of all states, or of those that are named."""
    folder, names = Path(sys.argv[1]), sys.argv[2:] or [*STATES, "list"]
    folder.mkdir(parents=True, exist_ok=True)
    with ExitStack() as ending:
        browser = ending.enter_context(contextmanager(driver.__wrapped__)())
        one, many = (Path(ending.enter_context(tempfile.TemporaryDirectory())) for _ in range(2))
        trouble = Trouble(one, ending)
        for name in names:
            if name != "list":
                take_arm(trouble, Shown(browser, trouble.url), folder, name)
        if "list" in names:
            router = Router(ending)
            arms = [PlayedArm(ending, router.client(), f"arm{k:02}") for k in range(1, 21)]
            take_list(Shown(browser, Trouble(many, ending, router.endpoint).url), folder, arms)


if __name__ == "__main__":
    main()
