"""The page in a browser: a stop without an answer is told, and asked again over HTTP."""

from collections.abc import Iterator

import pytest

from tests.browser.conftest import Trouble
from tests.browser.rig import OPERATOR, Shown, eventually, told

pytestmark = pytest.mark.timeout(600)

# The network holds all that the page sends back while `holding`, and what the WebSocket sends for ever.
HOLDING = """
window.holding = false; window.waiting = [];
const send = WebSocket.prototype.send;
WebSocket.prototype.send = function (text) { if (!JSON.parse(text).do.startsWith("stop")) send.call(this, text); };
const fetched = window.fetch;
window.fetch = async (...words) => {
  if (window.holding) await new Promise((go) => window.waiting.push(go));
  return fetched(...words);
};
"""
LOOK = "const it = getComputedStyle(document.querySelector('#stop')); return [it.backgroundColor, it.color]"


@pytest.fixture
def shown(driver: object, trouble: Trouble) -> Iterator[Shown]:
    """The page of an arm whose network can stand still."""
    shown = Shown(driver, trouble.url)
    script = shown.driver.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": HOLDING})
    yield shown
    shown.driver.execute_cdp_cmd("Page.removeScriptToEvaluateOnNewDocument", script)
    shown.driver.get("about:blank")


@pytest.mark.parametrize(("path", "css"), [("/arms/planar16", "#stop"), ("/", "#stop-all")])
def test_a_stop_that_nobody_confirms_is_told_until_it_is(trouble: Trouble, shown: Shown, path: str, css: str) -> None:
    trouble.daemon.asked.clear()
    shown.visit(path, OPERATOR)
    eventually(lambda: shown.one(css).is_enabled())
    before = shown.run(LOOK.replace("#stop", css))
    shown.run("window.holding = true")
    shown.one(css).click()
    shown.says(css, "Stopping")
    assert shown.run(LOOK.replace("#stop", css)) != before, "pressed looks different from hovered"
    shown.says(".unconfirmed[role=alert]", "STOP NOT CONFIRMED", "Cut the arm's power", "hyperbit halt")
    shown.picture(f"more/panel-unconfirmed-{css[1:]}.png")
    assert "stop" not in trouble.daemon.commands()
    shown.run("window.holding = false; for (const go of window.waiting) go()")
    eventually(lambda: "stop" in trouble.daemon.commands())
    shown.says(".notice", "Stop", "planar16" if path == "/" else "stopped")
    eventually(lambda: not shown.one(".unconfirmed").is_displayed())
    assert "Stopping" not in shown.text(css)


def test_a_stop_that_the_daemon_refuses_is_asked_again_until_the_operator_ends_it(
    trouble: Trouble, shown: Shown
) -> None:
    accepted, trouble.daemon.answer = trouble.daemon.answer, {"accepted": False, "message": "the executor is silent"}
    try:
        shown.visit("/arms/planar16", OPERATOR)
        told(trouble, shown, reason="before a stop")
        shown.one("#stop").click()
        shown.says(".unconfirmed", "the executor is silent")
        shown.press(".unconfirmed button")
        eventually(lambda: not shown.one(".unconfirmed").is_displayed())
        assert "Stopping" not in shown.text("#stop")
    finally:
        trouble.daemon.answer = accepted
