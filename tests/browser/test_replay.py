"""A recording in the browser: the page shows the past, and its time line moves it."""

import re
from contextlib import closing
from pathlib import Path
from typing import NamedTuple

import pytest
import zenoh
from selenium.webdriver.common.keys import Keys

from hyperbit.controller.network import session
from hyperbit.controller.network.client import Client, Unanswered
from tests.browser.conftest import World
from tests.browser.rig import OPERATOR, Shown, eventually
from tests.endpoints import free_endpoint
from tests.recorder.samples import read_unfinished

pytestmark = pytest.mark.timeout(600)

BEFORE, AFTER = "0" * 16, "0" * 15 + "7"  # configurations; all actuators of the last module are extended in one of them
EXTENDED = """return [...document.querySelectorAll('#actuators .module:nth-child(16) .cell')]
    .map((cell) => cell.classList.contains('extended'))"""
TIMES = re.compile(r"replay of (\S+), (\S+) of (\S+) to (\S+)")


class Replayed(NamedTuple):
    file: Path
    url: str


@pytest.fixture(scope="module")
def replayed(world: World) -> Replayed:
    """A short recording in which the arm's last module moves, replayed."""
    folder, endpoint = world.folder("recordings"), world.endpoints["flat"]
    with eventually(lambda: opened(endpoint)) as live, closing(Client(live, "flat")) as client:
        bring(client, BEFORE)
        recorder = world.start(["record", "flat", "--folder", str(folder), "--connect", endpoint], folder)
        (file,) = eventually(lambda: list(folder.glob("*.mcap")))
        eventually(lambda: BEFORE in recorded(file))
        bring(client, AFTER)
        eventually(lambda: AFTER in recorded(file))
    recorder.terminate()
    assert recorder.wait() == 0
    past = free_endpoint()
    world.start(["replay", str(file), "--stay", "--listen", past], world.folder("replay"))
    return Replayed(file, world.panel("past", past, prefix="replay"))


def opened(endpoint: str) -> zenoh.Session | None:
    """A session with the planner; None if it is not there yet."""
    try:
        return zenoh.open(session.configuration("client", connect=endpoint))
    except zenoh.ZError:
        return None


def bring(client: Client, configuration: str) -> None:
    """Brings the arm to a configuration once it is ready; an aborted goal is sent again after a reset."""
    goal = {"waypoints": [{"configuration": configuration}]}

    def brought() -> bool:
        try:
            if client.run(goal, lambda message: None).get("status") == "succeeded":
                return True
            client.request("reset")
        except Unanswered:
            pass
        return False

    eventually(brought)


def recorded(file: Path) -> list[str]:
    """The configurations in which the arm holds in the states of a recording that is still written."""
    states = [it.data for it in read_unfinished(file.read_bytes()) if it.topic.endswith("/state")]
    return [state["configuration"] for state in states if state["mode"] == "ready"]


def test_a_recording_is_shown_and_its_time_line_moved(replayed: Replayed, driver: object) -> None:
    shown = Shown(driver, replayed.url)
    shown.visit("/arms/flat", OPERATOR)
    shown.says(".timeline", f"replay of {replayed.file.name}")
    shown.press("#pause")
    shown.says("#pause", "Play")
    slider = shown.one(".timeline input")
    slider.send_keys(Keys.HOME)
    eventually(lambda: shown.run(EXTENDED) == [False] * 3)
    slider.send_keys(Keys.END)
    eventually(lambda: shown.run(EXTENDED) == [True] * 3)
    eventually(lambda: len(set(times(shown)[1::2])) == 1)
    shown.press(".timeline option[value='20']")
    slider.send_keys(Keys.HOME)
    eventually(lambda: shown.run(EXTENDED) == [False] * 3 and len(set(times(shown)[1:3])) == 1)
    assert shown.run("return document.querySelector('.timeline select').value") == "20"
    eventually(lambda: not shown.run("return document.body.classList.contains('old')"))
    shown.says("#mode", "ready")
    looks_like_the_past(shown, replayed.file)
    shown.picture("panel-replay.png")
    shown.press("#pause")
    shown.says("#pause", "Pause")
    eventually(lambda: shown.run(EXTENDED) == [True] * 3 and len(set(times(shown)[1::2])) == 1)
    assert shown.text("#goals li").startswith("✓ succeeded")


def looks_like_the_past(shown: Shown, file: Path) -> None:
    """Checks that the page says it is a replay, commands nothing."""
    shown.says("#replay", f"Replay of {file.name}", "Nothing here moves an arm")
    assert not shown.one("#stop").is_enabled()
    assert not shown.one("#reset").is_enabled()
    for css in ("#go", "#cancel", "#jog", "#take", "#play", "#obstacles details"):
        assert not any(element.is_displayed() for element in shown.all(css)), css


def times(shown: Shown) -> tuple[str, ...]:
    """The file, where the replay is, its begin and end, as the page says."""
    found = TIMES.search(shown.text(".timeline"))
    assert found is not None
    return found.groups()
