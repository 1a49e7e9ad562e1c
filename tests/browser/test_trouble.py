"""The page in a browser, with a fake daemon that sends malformed and late messages, and people without access."""

import pytest
from selenium.webdriver.common.keys import Keys

from tests.browser.conftest import Trouble
from tests.browser.rig import OPERATOR, VIEWER, Shown, eventually, found

pytestmark = pytest.mark.timeout(600)

DIAGNOSTICS = {
    "buses": [
        {"name": "can0", "state": "connected", "load": 0.1, "worst_case": {"load": 0.3}, "dropped": 0}
        | dict.fromkeys(("tx_frames", "rx_frames", "tx_errors", "rx_errors"), 0)
    ],
    "boards": [{"bus": "can0", "node": 1, "state": "operational", "emergency": None, "heartbeat_age": 0.1}],
    "loop": {"late_worst": 0.001},
    "counts": [7, *[0] * 47],
    "dropped": 0,
}


def test_a_malformed_message_is_left_out(trouble: Trouble, driver: object) -> None:
    shown = Shown(driver, trouble.url)
    shown.visit("/arms/planar16", OPERATOR)
    shown.one("#boards .health")

    def says(css: str, *words: str) -> bool:
        trouble.daemon.state(reason="still shown")
        return all(word in shown.text(css) for word in words)

    def malformed() -> bool:
        trouble.daemon.put("diagnostics", {"buses": 3, "counts": [1, 2]})
        return says("#reason", "still shown") and "3 switches" not in shown.text("#wear")

    def repaired() -> bool:
        trouble.daemon.put("diagnostics", DIAGNOSTICS)
        return says("#boards", "can0", "connected") and says("#wear", "7 switches in all; most: 1.left with 7")

    eventually(malformed, lambda: shown.text("body"))
    eventually(repaired, lambda: shown.text("body"))


def test_counts_that_come_before_the_labels_name_no_actuator(trouble: Trouble, driver: object) -> None:
    shown = Shown(driver, trouble.url)
    shown.visit("/arms/planar16", OPERATOR)
    words = shown.driver.execute_async_script(  # type: ignore[attr-defined]
        """
        const done = arguments[0];
        document.body.innerHTML = '<section id="wear"></section>';
        import('/static/js/charts.js').then(({ showWear }) => {
          const latest = {}, listeners = {};
          showWear({ latest, on: (section, listener) => (listeners[section] = listener) });
          const tell = (section, message) => { latest[section] = message; listeners[section](message); };
          const said = [];
          tell('diagnostics', { counts: [0, 3] });
          said.push(document.querySelector('#wear .hint').textContent);
          tell('arm', { actuators: ['1.left', '1.right'] });
          said.push(document.querySelector('#wear .hint').textContent);
          done(said);
        });"""
    )
    assert words == ["3 switches in all.", "3 switches in all; most: 1.right with 3."]


def test_a_wrong_token_in_the_address_is_named(trouble: Trouble, driver: object) -> None:
    shown = Shown(driver, trouble.url)
    shown.visit("/arms/planar16", "wrong")
    shown.says(".message", "The token in the address was refused", "nobody's")
    shown.one("form input").send_keys(OPERATOR, Keys.ENTER)
    shown.says("#control", "You are anna, operator")


def test_log_out_closes_the_other_pages_of_the_session(trouble: Trouble, driver: object) -> None:
    shown = Shown(driver, trouble.url)
    shown.visit("/arms/planar16", OPERATOR)
    shown.says("#control", "You are anna, operator")
    shown.run("fetch('/session', { method: 'DELETE' })")
    shown.one("form input")


def test_the_log_says_a_fault_once(trouble: Trouble, driver: object) -> None:
    shown = Shown(driver, trouble.url)
    shown.visit("/arms/planar16", OPERATOR)
    trouble.daemon.state(mode="fault", reason="the interlock is open")
    shown.says("#log", "fault: the interlock is open")
    assert "fault: fault:" not in shown.text("#log")


def test_a_viewer_is_not_told_to_press_go(trouble: Trouble, driver: object) -> None:
    shown = Shown(driver, trouble.url)
    shown.visit("/arms/planar16", VIEWER)
    shown.says("#goal", "A viewer sees goals and sends none")
    assert "Nothing moves before Go" not in shown.text("#goal")


def test_go_is_disabled_while_the_arm_is_silent(trouble: Trouble, driver: object) -> None:
    shown = Shown(driver, trouble.url)
    shown.visit("/arms/planar16", OPERATOR)
    for k, number in enumerate(("0.5", "2.8"), 1):
        shown.type(f"#goal .fields label:nth-child({k}) input", number)

    def enabled() -> bool:
        trouble.daemon.state()
        return bool(shown.one("#go").is_enabled())

    eventually(enabled, lambda: shown.text("#goal"))
    shown.says("#goal .why", "Nothing is heard from the arm")
    assert not shown.one("#go").is_enabled()
    eventually(enabled, lambda: shown.text("#goal"))


def test_axe_finds_nothing_while_the_arm_is_silent(trouble: Trouble, driver: object) -> None:
    shown = Shown(driver, trouble.url)
    shown.visit("/arms/planar16", OPERATOR)
    trouble.daemon.state(reason="the last state")
    eventually(lambda: "old" in shown.run("return document.body.className"))
    assert found(shown) == []


def test_all_arms_are_stopped_from_the_list(trouble: Trouble, driver: object) -> None:
    shown = Shown(driver, trouble.url)
    shown.visit("/", VIEWER)
    shown.says(".who", "viewer")
    assert not shown.one("#stop-all").is_enabled()
    shown.visit("/", OPERATOR)
    shown.says(".who", "operator")
    shown.says(".arms", "planar16")
    shown.press("#stop-all")
    eventually(lambda: "stop" in trouble.daemon.commands())
    shown.says(".notice", "Stop all: stopped: planar16")


def test_the_legend_names_all_that_is_drawn(trouble: Trouble, driver: object) -> None:
    shown = Shown(driver, trouble.url)
    shown.visit("/arms/planar16", VIEWER)
    shown.says(".legend", "measured", "commanded", "planned", "deviation", "goal", "waypoints", "obstacle")
    shown.picture("more/panel-legend.png")
