"""A commission on the page: a person with a phone beside an arm whose wires differ from its file."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from tests.browser.conftest import ROOT, Trouble
from tests.browser.rig import OPERATOR, VIEWER, Shown, eventually, found
from tests.commission.rig import entries, write_arm
from tests.endpoints import free_endpoint

pytestmark = pytest.mark.timeout(600)


@pytest.fixture
def shown(tmp_path: Path, driver: Any) -> Iterator[Shown]:
    file, truth = entries("one output", "both ends"), entries("one output", "both ends")
    truth["1.1"]["output"], truth["1.2"]["output"] = 1, 0
    path, true = write_arm(tmp_path / "arm.yaml", file), write_arm(tmp_path / "true.yaml", truth)
    words = ["commission", str(path), "--simulate", "--wired", str(true), "--watch", "0.3", "--page"]
    with ExitStack() as closing, (tmp_path / "told").open("w") as told:
        endpoint = free_endpoint()
        command = [sys.executable, "-m", "hyperbit", *words, "--listen", endpoint]
        process = subprocess.Popen(command, cwd=ROOT, stdin=subprocess.PIPE, stdout=told, stderr=told)
        closing.callback(process.wait)
        closing.callback(process.send_signal, signal.SIGINT)
        panel = tmp_path / "panel"
        panel.mkdir()
        yield Shown(driver, Trouble(panel, closing, endpoint).url)


def questions(shown: Shown) -> str:
    return str(shown.run("return document.querySelector('.asked')?.textContent ?? ''"))


def hold(shown: Shown, key: str, then: str) -> None:
    """Holds an answer's button until the page asks what comes then; a slow browser may need another try."""

    def held() -> bool:
        if then not in questions(shown):
            shown.hold(f".answers button[data-key='{key}']")
        return then in questions(shown)

    eventually(held, lambda: questions(shown))


def test_a_person_with_a_phone_commissions_an_arm(shown: Shown, tmp_path: Path) -> None:
    shown.visit("/arms/small", VIEWER, 360, 740)
    shown.says(".asked", "Ready to")
    assert not shown.all(".answers button"), "a viewer answers nothing"
    for width, height, dark in ((1280, 860, False), (1280, 860, True), (360, 740, True), (360, 740, False)):
        shown.visit("/arms/small", OPERATOR, width, height, dark=dark)
        shown.says(".asked", "Ready to extend 1.1")
        shown.one(".answers button")
        assert found(shown) == []
        shown.picture(f"more/commission-{width}-{'dark' if dark else 'light'}.png")
    hold(shown, "", "what was seen")
    stop = shown.one("#stop").rect
    assert stop["y"] + stop["height"] <= 740, "Stop is in sight"
    assert found(shown) == []
    shown.picture("more/commission-seen.png")
    shown.driver.refresh()
    shown.says(".asked", "1.1 was told to extend; what was seen")
    shown.run("document.querySelector('select[name=which]').value = '1.2'")
    shown.press_named(".another button", "extended")
    shown.says(".asked", "Ready to contract 1.1")
    shown.says(".told", "inputs: 1.2.input_contracted to 0", "1.2.input to 1")
    shown.press("#stop")
    shown.says(".asked", "Nothing moves by a reset")
    shown.says("#mode", "stopped")
    shown.picture("more/commission-stopped.png")
    hold(shown, "r", "Ready to contract 1.1")
    shown.press_named(".answers button", "Leave")
    shown.says("#reason", "the commission has ended")
    record = json.loads((tmp_path / "arm.commission.json").read_text())
    assert [(it["actuator"], it["moved"], it["to"]) for it in record["sightings"]] == [("1.1", "1.2", 1)]
