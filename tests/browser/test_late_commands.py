"""Commands of the page that the network holds back: a goal is refused, a stop is carried out."""

import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from hyperbit.controller.panel.arms.heartbeats import LONGEST
from tests.browser.conftest import Trouble
from tests.browser.rig import OPERATOR, Shown, eventually

pytestmark = pytest.mark.timeout(600)

# The page sends into `held` while `holding`; `heard` are the heartbeats that have come.
HOLDING = """
window.heard = []; window.held = []; window.holding = false;
const send = WebSocket.prototype.send;
WebSocket.prototype.send = function (text) {
  const now = () => send.call(this, text);
  const command = JSON.parse(text);
  if (window.holding) window.held.push({ command, now, heard: window.heard.at(-1) });
  else now();
};
const messages = Object.getOwnPropertyDescriptor(WebSocket.prototype, "onmessage");
Object.defineProperty(WebSocket.prototype, "onmessage", {
  ...messages,
  set(listener) {
    messages.set.call(this, (event) => {
      for (const part of JSON.parse(event.data)) if (part.section === "heartbeat") window.heard.push(part.number);
      listener(event);
    });
  },
});
"""
HELD = "return window.held.map(({ command, heard }) => [command.do, command.heartbeat === heard])"


@pytest.fixture
def strict(tmp_path: Path) -> Iterator[Trouble]:
    """A fake daemon, and a panel that refuses late commands."""
    with ExitStack() as closing:
        yield Trouble(tmp_path, closing, patient=False)


@pytest.fixture
def shown(driver: object, strict: Trouble) -> Iterator[Shown]:
    """The page of an arm whose network can stand still."""
    shown = Shown(driver, strict.url)
    script = shown.driver.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": HOLDING})
    yield shown
    shown.driver.execute_cdp_cmd("Page.removeScriptToEvaluateOnNewDocument", script)
    shown.driver.get("about:blank")  # before the panel ends


def test_a_goal_that_the_network_holds_back_is_refused_and_a_stop_is_not(strict: Trouble, shown: Shown) -> None:
    daemon = strict.daemon
    shown.visit("/arms/planar16", OPERATOR)
    shown.says("#control", "You are anna, operator")
    eventually(lambda: shown.run("return window.heard.length > 3"))

    def planned() -> bool:
        daemon.state()
        shown.run("document.querySelector('#go').disabled || (window.holding = true)")
        return bool(shown.run("return window.holding"))

    for k, number in enumerate(("0.5", "2.8"), 1):
        shown.type(f"#goal .fields label:nth-child({k}) input", number)
    eventually(planned, lambda: shown.text("#goal"))
    shown.run("document.querySelector('#go').click(); document.querySelector('#stop').click()")
    assert shown.run(HELD) == [["go", True], ["stop", True]]
    pressed = time.monotonic()
    eventually(lambda: time.monotonic() > pressed + LONGEST + 0.1)
    shown.run("window.holding = false; for (const { now } of window.held) now()")
    shown.says("#goal .message", "too late", "look at the arm, then press again")
    eventually(lambda: "stop" in daemon.commands())
    assert "goal" not in daemon.commands()
