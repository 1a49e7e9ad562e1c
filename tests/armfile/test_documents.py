"""Payloads in files: JSON as a payload over Zenoh, otherwise YAML."""

import json
from pathlib import Path

import pytest

from hyperbit.controller.armfile.documents import parse_payload
from hyperbit.controller.armfile.strict import InputFaults

GOAL = {"waypoints": [{"position": [1e-05, 2.9], "t": 0}]}


@pytest.mark.parametrize("name", ["goal.json", "goal.yaml", "goal"])
@pytest.mark.parametrize("indent", [None, "\t"])
def test_json_is_read_as_json_in_a_file_of_any_name(name, indent):
    assert parse_payload(json.dumps(GOAL, indent=indent), Path(name), "goal", "waypoints") == GOAL


def test_other_files_are_read_as_yaml():
    assert parse_payload("waypoints: [{position: [1, 2]}]", Path("goal"), "goal", "waypoints") == {
        "waypoints": [{"position": [1, 2]}]
    }


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("waypoints: []", "goal.json: is not JSON: Expecting value: line 1 column 1"),
        ('{"a": 1, "a": 2}', "goal.json: is not JSON: 'a' occurs twice in one object"),
        ("[1]", "goal.json: no goal: a mapping with `waypoints` is needed"),
        ('{"a": ' * 100_000, "goal.json: its values are nested hundreds of levels deep"),
        ('{"a": NaN}', "goal.json: no goal: Out of range float values"),
        ('{"a": "\\ud800"}', "goal.json: no goal: 'utf-8' codec can't encode"),
    ],
)
def test_what_is_refused(text, fault):
    with pytest.raises(InputFaults) as caught:
        parse_payload(text, Path("goal.json"), "goal", "waypoints")
    assert fault in str(caught.value)
