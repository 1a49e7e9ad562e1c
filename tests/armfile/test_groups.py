"""Groups: a list of modules that repeats is the same chain as its modules written out."""

from pathlib import Path

import numpy as np
import pytest
import yaml

from hyperbit.controller.arm.arm import load
from hyperbit.controller.arm.summary import summarize
from hyperbit.controller.arm.warnings import file_warnings
from hyperbit.controller.armfile.actuators import actuator_names
from hyperbit.controller.armfile.modules import MOST_MODULES, chain, places
from hyperbit.controller.armfile.strict import InputFaults

SLIDE = {"type": "prismatic", "axis": [0, 1], "cylinders": [[0, 25], [0, 50]], "link": {"position": [0, 60]}}
JOINT = {"type": "revolute", "angles": [-0.5, 0.5], "link": {"position": [0, 40]}}
TRUSS = {"type": "vgt", "width": 100, "lengths": [100, 125], "count": 3}


def document(*modules: dict) -> dict:
    return {"name": "lift", "modules": list(modules), "tolerance": {"position": 2}}


def group(count: int, *modules: dict, **more: object) -> dict:
    return {"count": count, "modules": list(modules), **more}


def refusal(read, value: dict) -> str:
    with pytest.raises(InputFaults) as caught:
        read(value)
    return str(caught.value)


@pytest.mark.parametrize("named", [{}, {"type": "group"}])
def test_a_group_is_the_chain_of_its_modules_written_out(read, named: dict) -> None:
    arm = read(document(JOINT, group(3, SLIDE, TRUSS, **named), TRUSS))
    plain = read(document(JOINT, *[SLIDE, TRUSS] * 3, TRUSS))
    assert np.array_equal(arm.manipulator.frames, plain.manipulator.frames)
    assert arm.manipulator.actuators == plain.manipulator.actuators
    bodies = zip(arm.manipulator.modules, plain.manipulator.modules, strict=True)
    assert all(np.array_equal(own.body, other.body) for own, other in bodies)
    names = actuator_names(arm.settings.modules, Path(), [])
    assert [name for own in names for name in own] == [it.partition(".")[2] for it in plain.manipulator.actuators]
    assert summarize(arm)["modules"] == {"revolute": 1, "prismatic": 3, "vgt": 12}


def test_repetitions_share_their_modules(read) -> None:
    arm = read(document(group(4, SLIDE, JOINT)))
    assert len(set(map(id, arm.manipulator.modules))) == 2


def test_a_place_names_entry_and_repetition(read) -> None:
    settings = read(document(JOINT, group(3, SLIDE, {**JOINT, "count": 2}))).settings
    assert [it.place for it in chain(settings.modules)][1:3] == [
        "modules[1].modules[0] in repetition 1",
        "modules[1].modules[1] in repetition 1",
    ]
    assert [it.repetition for it in places(settings.modules)] == [0, 1, 1, 1, 2, 2, 2, 3, 3, 3]


@pytest.mark.parametrize(
    ("modules", "fault"),
    [
        ([group(2, SLIDE, {**JOINT, "angles": [0.1, "x"]})], "modules[1].modules[2].angles[2]: Expected"),
        ([group(2, SLIDE, {**JOINT, "angles": [0.1, 0.1]})], "modules[1].modules[2].angles: 0.1 occurs twice"),
        ([group(0, SLIDE)], "modules[1].count: Expected `int` >= 1"),
        ([group(2)], "modules[1].modules: Expected `array` of length >= 1"),
        ([group(2, group(2, SLIDE))], "modules[1].modules[1].type: required, but missing; it must be one of vgt,"),
        ([group(2, SLIDE, width=3)], "modules[1].width: unknown field; known are count, modules, type"),
        ([group(9999, {**SLIDE, "count": 9999})], f"modules: 99980001 modules, at most {MOST_MODULES} are possible"),
        ([{"count": 2}], "modules[1].type: required, but missing; it must be one of vgt, revolute"),
        ([group(2, SLIDE), {"modules": 5}], "modules[2].modules: Expected `array`, got `int`"),
    ],
)
def test_each_fault_names_entry_and_module(read, modules: list[dict], fault: str) -> None:
    assert fault in refusal(read, document(*modules))


def test_a_fault_of_a_group_is_told_once(read) -> None:
    assert refusal(read, document(group(5, TRUSS, {**TRUSS, "lengths": [125, 100]}))).count("not 100 extended") == 3


def test_an_unmapped_actuator_names_its_repetition(read) -> None:
    value = document(group(2, SLIDE, JOINT))
    rows = [{"module": 1, "actuator": "1", "bus": "can0", "node": 1, "output": 0}]
    told = refusal(read, {**value, "buses": [{"name": "can0", "channel": "can0"}], "actuators": rows})
    assert "actuators: 4.1 is not mapped (modules[1].modules[2] in repetition 2)" in told


def test_a_warning_of_a_group_has_its_line_once(tmp_path: Path) -> None:
    path = tmp_path / "arm.yaml"
    path.write_text(
        yaml.safe_dump(document(group(3, {**JOINT, "angles": [-0.5, 5.0]}, {**SLIDE, "link": {"position": [0, 9000]}})))
    )
    (far, turned) = file_warnings(load(path))
    assert "modules[1].modules[2]: 9000 long" in far or "modules[1].modules[2]: 9075 long" in far
    assert "modules[1].modules[1].angles[2]: 5 rad are more than" in turned
