"""Warnings about values that are allowed, but probably mistakes."""

from pathlib import Path

import pytest

from hyperbit.controller.arm.arm import load
from hyperbit.controller.arm.warnings import BIT_RATES, file_warnings
from tests.arm_files import TRUSS, changed, document, listed

ARMS = [
    *Path(__file__).parents[2].glob("deploy/*.yaml"),
    *Path(__file__).parents[2].glob("controller/bench/arms/*.yaml"),
]
PLANNED = {"name": "planned", "tolerance": {"position": 0.01}}
MILLIMETRES = {"type": "vgt", "width": 200, "lengths": [200, 250]}
CENTIMETRES = {"type": "vgt", "width": 20, "lengths": [20, 25]}
HINGE = {"type": "revolute", "angles": [0, 0.3]}  # without a link: it has no size


def without_path(warnings: list[str]) -> list[str]:
    return [warning.split(": ", 1)[1] for warning in warnings]


@pytest.mark.parametrize("path", ARMS, ids=lambda path: path.stem)
def test_the_shipped_arms_have_no_warning(path):
    text = path.read_text()
    if "modules:" in text:
        assert file_warnings(load(path)) == []


@pytest.mark.parametrize(
    ("modules", "field"),
    [
        ([{**TRUSS, "count": 3}, MILLIMETRES], "modules[2]: "),
        ([MILLIMETRES, {**TRUSS, "count": 3}], "modules[1]: "),
        ([{**TRUSS, "count": 3}, CENTIMETRES], "modules[2]: "),
        ([{**MILLIMETRES, "count": 3}, TRUSS], "modules[2]: "),
        ([TRUSS, MILLIMETRES], "modules[2]: "),
        ([HINGE, HINGE, TRUSS, TRUSS, MILLIMETRES], "modules[5]: "),
    ],
)
def test_a_module_in_another_unit_is_named(read, modules, field):
    [warning] = without_path(file_warnings(read({**PLANNED, "modules": modules})))
    assert warning.startswith(field)
    assert "check the unit of its lengths" in warning


@pytest.mark.parametrize(
    "modules",
    [
        [TRUSS],
        [MILLIMETRES],
        [HINGE],
        [TRUSS, HINGE],
        [TRUSS, *listed({"position": [0, 0.01]}, {"position": [0, 0.02]})],
    ],
)
def test_modules_of_like_size_bring_no_warning(read, modules):
    assert file_warnings(read({**PLANNED, "modules": modules})) == []


@pytest.mark.parametrize(("pulse", "count"), [(5, 1), (0.06, 1), (0.05, 0), (0.02, 0)])
def test_a_pulse_longer_than_the_travel_is_named(read, pulse, count):
    value = document()
    value["actuators"][4].update(output_off=7, pulse=pulse)
    warnings = without_path(file_warnings(read(value)))
    assert len(warnings) == count
    assert all(w.startswith(f"actuators[5].pulse: {pulse:g} s, but the actuator travels for 0.05 s") for w in warnings)


def test_a_pulse_is_compared_with_the_time_of_its_own_actuator(read):
    value = document()
    value["actuators"][0].update(output_off=7, pulse=0.3, travel_time={"extend": 0.4, "contract": 0.1})
    assert file_warnings(read(value)) == []


@pytest.mark.parametrize(
    ("island", "bits", "warning"),
    [
        (True, {"output": 4}, None),
        (False, {"output": 5}, None),
        (True, {"output": 5}, "actuators[5].output: 5 is the second solenoid of the place of outputs 4 and 5 of"),
        (True, {"output": {"bit": 5}, "output_off": 4}, None),
        (True, {"output": 5, "output_off": 6}, "actuators[5].output_off: 6 is not in the place of outputs 4 and 5 of"),
    ],
)  # fmt: skip
def test_outputs_of_an_island_that_are_not_those_of_one_valve_are_named(read, island, bits, warning):
    value = document()
    value["actuators"][4].update(bits)
    value["boards"]["nodes"] = [{"bus": "can0", "node": 2, "island": island}]
    assert value["actuators"][4]["node"] == 2
    found = [w for w in without_path(file_warnings(read(value))) if w.startswith("actuators[5]")]
    assert (len(found), found[0][: len(warning)]) == (1, warning) if warning else found == []


@pytest.mark.parametrize("rate", [10_000, 123_456, 100_000, 83_333, *BIT_RATES])
def test_an_unusual_bit_rate_is_named(read, rate):
    warnings = file_warnings(read(changed("buses.1.bitrate", rate)))
    assert bool(warnings) == (rate not in BIT_RATES)
    assert all(", line " in warning and "buses[2].bitrate: " in warning for warning in warnings)


@pytest.mark.parametrize(
    ("field", "value", "warning"),
    [
        ("tolerance.position", 15, "tolerance.position: 15, but the whole arm is 0.5 long; check the unit"),
        ("body_radius", 0.3, "body_radius: 0.3, but the whole arm is 0.5 long; check the unit"),
        ("workspace", {"pixel": 2}, "workspace.pixel: 2, but the whole arm is 0.5 long; check the unit"),
        ("tracker", {"noise": 2, "clamp": 0.1}, "tracker.noise: 2, but the whole arm is 0.5 long"),
        ("obstacles", [{"disc": {"centre": [500, 2800], "radius": 300}}], "obstacles[1].disc: 300 large and 2844 from"),
        ("obstacles", [{"box": {"centre": [0.5, 900], "size": [1, 1], "angle": 5}}], "obstacles[1].box: 1 large"),
        ("base", {"position": [0, 0], "orientation": 5}, "base.orientation: 5 rad are more than three quarters of a"),
        (
            "tolerance.orientation",
            5,
            "tolerance.orientation: 5 rad are more than three quarters of a turn; in radians, 5",
        ),
    ],
)
def test_millimetres_and_degrees_are_told(read, field, value, warning):
    found = without_path(file_warnings(read(changed(field, value))))
    assert found[0].startswith(warning)


def test_degrees_of_joints_and_links_are_told(read):
    joint = {"type": "revolute", "angles": [-10, 10], "link": {"position": [0, 0.1], "orientation": 6}}
    fixed = {"type": "transforms", "states": [{"position": [0, 0.1]}, {"position": [0, 0.1], "orientation": 5}]}
    found = without_path(file_warnings(read({**PLANNED, "modules": [joint, fixed]})))
    paths = ["modules[1].angles[1]", "modules[1].angles[2]", "modules[1].link.orientation"]
    assert [warning.split(": ")[0] for warning in found] == [*paths, "modules[2].states[2].orientation"]


def test_millimetres_and_degrees_of_a_tip_and_of_cylinders_are_told(read):
    joint = {"type": "revolute", "cylinders": [[-0.2, 5]], "link": {"position": [0, 0.1]}}
    tip = {"position": [0, 30], "orientation": 6}
    found = without_path(file_warnings(read({**PLANNED, "modules": [joint, joint], "tip": tip})))
    told = {warning.split(": ")[0] for warning in found}
    assert {"tip.position", "tip.orientation", "modules[1].cylinders[1][2]"} <= told
