"""The page in a browser after the computer's sleep: its WebSocket is dead, and the browser does not tell."""

from collections.abc import Iterator

import pytest

from tests.browser.conftest import Trouble
from tests.browser.rig import OPERATOR, Shown, eventually

pytestmark = pytest.mark.timeout(600)

# A WebSocket that is `dead` tells the page neither messages nor its end. With `window.timers` false no timer repeats.
SLEEP = """
window.opened = []; window.dead = null;
for (const name of ["onmessage", "onclose"]) {
  const own = Object.getOwnPropertyDescriptor(WebSocket.prototype, name);
  Object.defineProperty(WebSocket.prototype, name, {
    ...own,
    set(listener) { own.set.call(this, listener && ((event) => this === window.dead || listener(event))); },
  });
}
const Own = window.WebSocket;
window.WebSocket = class extends Own { constructor(...words) { super(...words); window.opened.push(this); } };
"""
NO_TIMERS = "window.setInterval = () => 0;"


@pytest.fixture
def shown(driver: object, trouble: Trouble, request: pytest.FixtureRequest) -> Iterator[Shown]:
    shown = Shown(driver, trouble.url)
    source = SLEEP + request.param
    script = shown.driver.execute_cdp_cmd("Page.addScriptToEvaluateOnNewDocument", {"source": source})
    shown.visit("/arms/planar16", OPERATOR)
    shown.says("#control", "You are anna, operator")
    yield shown
    shown.driver.execute_cdp_cmd("Page.removeScriptToEvaluateOnNewDocument", script)
    shown.driver.get("about:blank")


@pytest.mark.parametrize(
    ("shown", "event"),
    [
        ("", ""),
        (NO_TIMERS, "window.dispatchEvent(new Event('online'))"),
        (NO_TIMERS, "document.dispatchEvent(new Event('visibilitychange'))"),
    ],
    indirect=["shown"],
)
def test_the_page_connects_again_after_a_sleep(trouble: Trouble, shown: Shown, event: str) -> None:
    shown.run(f"window.dead = window.opened.at(-1); {event}")

    def heard() -> bool:
        trouble.daemon.state(reason=f"after the sleep {event}")
        return shown.text("#reason") == f"after the sleep {event}"

    eventually(heard, lambda: shown.text("#silence"))
    assert shown.run("return window.opened.length === 2 && window.dead.readyState >= WebSocket.CLOSING")
    shown.one("#stop").click()
    shown.says(".notice", "Stop: stopped")


@pytest.mark.parametrize("shown", [""], indirect=True)
def test_a_page_that_is_heard_keeps_its_connection(trouble: Trouble, shown: Shown) -> None:
    shown.run("window.woken = performance.now(); window.dispatchEvent(new Event('online'))")
    eventually(lambda: shown.run("return performance.now() - window.woken > 3000"))
    assert shown.run("return window.opened.length") == 1


@pytest.mark.parametrize("shown", [""], indirect=True)
def test_after_the_log_out_the_page_does_not_connect_again(trouble: Trouble, shown: Shown) -> None:
    shown.run("fetch('/session', { method: 'DELETE' })")
    shown.one("form input")
    shown.run("window.woken = performance.now(); window.dispatchEvent(new Event('online'))")
    eventually(lambda: shown.run("return performance.now() - window.woken > 7000"))
    assert shown.run("return window.opened.length") == 1
