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
    """Returns the warnings without the file and the line."""
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


@pytest.mark.parametrize("rate", [10_000, 123_456, 100_000, 83_333, *BIT_RATES])
def test_an_unusual_bit_rate_is_named(read, rate):
    warnings = file_warnings(read(changed("buses.1.bitrate", rate)))
    assert bool(warnings) == (rate not in BIT_RATES)
    assert all(", line " in warning and "buses[2].bitrate: " in warning for warning in warnings)
