"""The proposal changes the fields of rows, and keeps everything else of the text."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml
from msgspec.structs import replace

from hyperbit.controller.armfile.actuators import read_wired
from hyperbit.controller.armfile.settings import BitSettings, InputSettings
from hyperbit.controller.commission.proposal import proposed_text

HEAD = """\
name: small  # an arm
modules: [{type: revolute, cylinders: [[0, 1]], link: {position: [1, 0]}}]
tolerance: {position: 0.1}
buses: [{name: can0, channel: can0, interface: virtual}]
"""
FLOW = HEAD + 'actuators:\n  - {module: 1, actuator: "1", bus: can0, node: 1, output: 0, input: 3}  # old\n'
BLOCK = (
    HEAD
    + 'actuators:\n  - module: 1\n    actuator: "1"\n    bus: can0\n    node: 1\n    output: 0\n    input: 3  # old\n'
)
JSON = json.dumps(yaml.safe_load(FLOW), indent=1)
OTHER = InputSettings(2, inverted=True, board="can0/9")


@pytest.mark.parametrize(
    ("text", "changes", "travel", "old", "new"),
    [
        (FLOW, {"output": BitSettings(4, True)}, None, "output: 0", "output: {bit: 4, inverted: true}"),
        (FLOW, {"input": None, "input_contracted": 3}, None, ", input: 3}", ", input_contracted: 3}"),
        (BLOCK, {"input": None, "input_contracted": 3}, None, "    input: 3", "    input_contracted: 3"),
        (BLOCK, {"input": OTHER}, None, "input: 3", "input: {bit: 2, inverted: true, board: can0/9}"),
        (BLOCK, {"node": 5}, None, "node: 1", "node: 5"),
        (FLOW, {}, "{extend: 1, contract: 2}", "actuators:", "travel_time: {extend: 1, contract: 2}\nactuators:"),
        (JSON, {}, "{extend: 1, contract: 2}", '"actuators"', 'travel_time: {extend: 1, contract: 2}, "actuators"'),
    ],
)
def test_only_the_changed_fields_of_the_text_change(
    tmp_path: Path, text: str, changes: dict[str, object], travel: str | None, old: str, new: str
) -> None:
    path = tmp_path / "arm.yaml"
    path.write_text(text)
    settings, labels, wired = read_wired(path)
    found = {labels[0]: replace(wired[0], **changes)}
    made = proposed_text(path, settings.actuators, found, travel)
    assert made == text.replace(old, new)
    path.write_text(made)
    assert read_wired(path)[2][0] == found[labels[0]]
