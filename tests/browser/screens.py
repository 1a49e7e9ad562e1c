"""Pictures of the page in each of its states, for a look at each: 1280, 768 and 360 pixels wide, light and dark.

python -m tests.browser.screens FOLDER [STATE ...]

The arms are real, with simulated boards; only the list of twenty arms has fake daemons. A file is named by state, width
and colours. It shows the first screen; on a phone the whole page, in columns.
"""

import sys
import tempfile
import threading
from base64 import b64decode
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

from PIL import Image

from hyperbit.controller.network.client import Client
from tests.browser.conftest import OPERATOR, Shown, World, driver, eventually
from tests.browser.test_page import type_goal
from tests.browser.test_replay import opened
from tests.endpoints import free_endpoint
from tests.network.played import PlayedArm, Router
from tests.recorder.samples import read_unfinished

SIZES = ((1280, 860), (768, 1024), (360, 740))
COLUMN = 1480  # [pixels], two screens of a phone
SLOW = {"travel_time": 2.0, "inrush": 1}  # a goal of this arm can be looked at while it runs
HOME, AWAY = "0" * 16, "7" * 16
MODES = ("ready", "ready", "executing", "ready", "stopped", "fault", "ready")  # of the twenty arms, in turn


class Screens:
    def __init__(self, world: World, browser: Any, folder: Path) -> None:
        self.world, self.browser, self.folder = world, browser, folder

    def take(self, state: str, url: str, path: str, prepare: Callable[[Shown], None]) -> None:
        """Takes six pictures of a state; `prepare` brings the page there."""
        shown = Shown(self.browser, url)
        for width, height in SIZES:
            for dark in (False, True):
                shown.visit(path, OPERATOR, width, height, dark=dark)
                prepare(shown)
                shown.run("window.scrollTo(0, 0)")
                picture = self._whole(shown) if width < 600 else self._screen(shown)
                picture.save(self.folder / f"{state}-{width}-{'dark' if dark else 'light'}.png", optimize=True)
        print(state, flush=True)

    def _screen(self, shown: Shown) -> Image.Image:
        return Image.open(BytesIO(shown.driver.get_screenshot_as_png())).convert("RGB")

    def _whole(self, shown: Shown) -> Image.Image:
        taken = shown.driver.execute_cdp_cmd("Page.captureScreenshot", {"captureBeyondViewport": True})
        page = Image.open(BytesIO(b64decode(taken["data"]))).convert("RGB")
        columns = -(-page.height // COLUMN)
        result = Image.new("RGB", (columns * (page.width + 20) - 20, min(page.height, COLUMN)), "gray")
        for k in range(columns):
            result.paste(page.crop((0, k * COLUMN, page.width, min(page.height, (k + 1) * COLUMN))), (k * 380, 0))
        return result


@contextmanager
def client_of(world: World, arm: str) -> Iterator[Client]:
    with eventually(lambda: opened(world.endpoints[arm])) as live, closing(Client(live, arm)) as client:
        eventually(client.alive)
        ready(client)
        yield client


def ready(client: Client) -> None:
    """Waits until an arm is ready, by a reset where it needs one."""

    def is_ready() -> bool:
        state = client.next_message("state")
        if state["mode"] in ("stopped", "fault"):
            client.request("reset")
        return bool(state["mode"] == "ready")

    eventually(is_ready)


def look(shown: Shown) -> None:
    shown.one(".stage canvas")
    shown.says("#reason", " ")
    eventually(lambda: shown.all("#boards .health"))


def look_at(mode: str) -> Callable[[Shown], None]:
    """Returns what waits until the page shows a mode."""

    def prepare(shown: Shown) -> None:
        look(shown)
        shown.says("#mode", mode)

    return prepare


def look_at_plan(shown: Shown) -> None:
    """Types a goal of the planar arm, and waits for its plan."""
    look(shown)
    shown.says("#mode", "ready")
    type_goal(shown, 0.9, 2.6)
    shown.says("#goal .plan", "switches")
    eventually(lambda: shown.one("#go").is_enabled())


def idle(screens: Screens) -> None:
    """The arm is ready."""
    screens.take("idle", screens.world.url, "/arms/flat", look_at("ready"))


def planned(screens: Screens) -> None:
    """A goal is planned."""
    screens.take("planned", screens.world.url, "/arms/flat", look_at_plan)


def moving(screens: Screens) -> None:
    """A goal of 48 switches runs, one switch at a time."""
    with client_of(screens.world, "slow") as client:

        def prepare(shown: Shown) -> None:
            ready(client)
            away = client.next_message("state")["configuration"] == HOME
            client.request("goal", {"waypoints": [{"configuration": AWAY if away else HOME}]})
            look_at("executing")(shown)
            eventually(lambda: shown.run("return document.querySelectorAll('#actuators .cell.extended').length") > 5)

        screens.take("moving", screens.world.url, "/arms/slow", prepare)
        client.request("stop")


def fault(screens: Screens) -> None:
    """Two boards are silent."""
    with client_of(screens.world, "flat") as client:
        for node in (5, 6):
            client.request("fault", {"fault": f"silence can0/{node}"})
        eventually(lambda: len(client.next_message("state")["faults"]) >= 2)
        screens.take("fault", screens.world.url, "/arms/flat", look_at("fault"))
        for node in (5, 6):
            client.request("fault", {"fault": f"unsilence can0/{node}"})
        ready(client)


def stopped(screens: Screens) -> None:
    """An operator stopped the arm."""
    with client_of(screens.world, "flat") as client:
        client.request("stop")
        screens.take("stopped", screens.world.url, "/arms/flat", look_at("stopped"))
        ready(client)


def locked(screens: Screens) -> None:
    """Three actuators are locked."""
    changes = {"3.left": 0, "7.diagonal": 0, "12.right": 0}
    with client_of(screens.world, "flat") as client:
        for name, state in changes.items():
            client.request("degrade", {"actuator": name, "state": state})
        eventually(lambda: len(client.next_message("state")["degraded"]) == len(changes))
        screens.take("locked", screens.world.url, "/arms/flat", look_at("ready"))
        for name in changes:
            client.request("degrade", {"actuator": name, "state": None})


def replay(screens: Screens) -> None:
    """The recording of a goal, replayed."""
    world = screens.world
    folder, past = world.folder("recordings"), free_endpoint()
    with client_of(world, "flat") as client:
        recorder = world.start(
            ["record", "flat", "--folder", str(folder), "--connect", world.endpoints["flat"]], folder
        )
        (file,) = eventually(lambda: list(folder.glob("*.mcap")))
        for configuration in ("0" * 15 + "7", "0123456701234567"):
            client.run({"waypoints": [{"configuration": configuration}]}, lambda message: None)
        eventually(lambda: "0123456701234567" in str([it.data for it in read_unfinished(file.read_bytes())]))
    recorder.terminate()
    recorder.wait()
    world.start(["replay", str(file), "--stay", "--listen", past], world.folder("replay"))

    def prepare(shown: Shown) -> None:
        look(shown)
        shown.says(".timeline", "replay of")

    screens.take("replay", world.panel("past", past, prefix="replay"), "/arms/flat", prepare)


def spatial(screens: Screens) -> None:
    """A goal of the arm in space is planned."""

    def prepare(shown: Shown) -> None:
        look_at("ready")(shown)
        type_goal(shown, 0.2, 0.1, 0.85)
        shown.says("#goal .plan", " ")

    screens.take("spatial", screens.world.url, "/arms/mixed", prepare)


def arms(screens: Screens) -> None:
    """The list of twenty arms."""
    with ExitStack() as ending:
        router, end = Router(ending), threading.Event()
        daemons = [PlayedArm(ending, router.client(), f"arm{k:02}") for k in range(1, 21)]

        def tell() -> None:
            while not end.wait(0.5):
                for k, daemon in enumerate(daemons):
                    tell_state(daemon, MODES[k % len(MODES)])

        teller = threading.Thread(target=tell)
        teller.start()
        ending.callback(teller.join)
        ending.callback(end.set)
        url = screens.world.panel("list", router.endpoint)

        def prepare(shown: Shown) -> None:
            eventually(lambda: shown.run("return document.body.innerText.split('arm').length") > 20)
            eventually(lambda: "fault" in shown.run("return document.body.innerText"))

        screens.take("list", url, "/", prepare)


def tell_state(daemon: PlayedArm, mode: str) -> None:
    faults = [{"code": "board-lost", "source": "can0/5", "message": "board can0/5 is silent"}]
    told: dict[str, dict[str, Any]] = {
        "executing": {"reason": "to the goal pick-7", "goal": "pick-7"},
        "stopped": {"reason": "stopped by anna"},
        "fault": {"reason": "board can0/5 is silent", "faults": faults, "configuration": None, "tip": None},
    }
    daemon.state(mode=mode, **told.get(mode, {}))


STATES = (idle, planned, moving, fault, stopped, locked, replay, spatial, arms)


def main() -> None:
    """Takes the pictures of all states, or of those that are named."""
    folder, names = Path(sys.argv[1]), sys.argv[2:]
    folder.mkdir(parents=True, exist_ok=True)
    with ExitStack() as ending, tempfile.TemporaryDirectory() as run:
        world = World(Path(run), ending, slow=SLOW)
        browser = ending.enter_context(contextmanager(driver.__wrapped__)())
        screens = Screens(world, browser, folder)
        for state in STATES:
            if not names or state.__name__ in names:
                state(screens)


if __name__ == "__main__":
    main()
