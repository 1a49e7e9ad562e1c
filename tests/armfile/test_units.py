"""Units: what a number with a unit stands for, and what a file without one says."""

from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from hyperbit.controller.arm.arm import load
from hyperbit.controller.armfile.settings import RoundSettings
from hyperbit.controller.armfile.strict import InputFaults, check
from hyperbit.controller.armfile.units import MILLIMETRES, NAMES, factors, metres_of, unit_name, value_in

JOINT = "{type: revolute, angles: [-30 deg, 0.5], link: {position: [0, 10 cm]}}"
SLIDE = "{type: prismatic, axis: [0, 1], cylinders: [[0, 25], [0, 50 mm]], link: {position: [0, 60]}}"
FILE = f"""
name: lift
unit: mm
modules: [{JOINT}, {SLIDE}]
tolerance: {{position: 2, orientation: 5 deg}}
travel_time: 80 ms
obstacles: [{{disc: {{centre: [1 m, 0], radius: 1 in}}}}]
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "arm.yaml"
    path.write_text(text)
    return path


def faults(folder: Path, text: str) -> str:
    with pytest.raises(InputFaults) as caught:
        load(written(folder, text))
    return str(caught.value)


def test_numbers_of_a_file_may_have_their_unit(tmp_path: Path) -> None:
    arm = load(written(tmp_path, FILE))
    joint, slide = arm.manipulator.modules
    assert joint.frames[0, :2, 3] == pytest.approx([50.0, 100 * 0.75**0.5])
    assert slide.frames[-1, 1, 3] == pytest.approx(135.0)
    assert (arm.angle_tolerance, arm.travel_time) == (pytest.approx(0.0872665), pytest.approx(0.08))
    (disc,) = arm.settings.obstacles
    assert disc.disc is not None
    assert (disc.disc.centre, disc.disc.radius) == ([1000.0, 0], pytest.approx(25.4))


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ("unit: mm", "", "modules[1].link.position[2]: Expected `float`, got `str` (given: '10 cm'); write a number"
         " without a unit, or name the unit of all lengths, as in unit: mm"),
        ("unit: mm", "unit: ft", "unit: 'ft' is unknown; it must be one of m, cm, mm, in"),
        ("10 cm", "10 deg", "modules[1].link.position[2]: Expected `float`, got `str` (given: '10 deg'); this number is"
         " in the unit of the arm's file"),
        ("-30 deg", "-30 mm", "modules[1].angles[1]: Expected `float`, got `str` (given: '-30 mm'); this number is in"
         " radians"),
        ("-30 deg", "-800 deg", "modules[1].angles[1]: Expected `float` >= -12.5664 (given: -13.96"),
        ("80 ms", "80 mm", "travel_time: Expected"),
        ("axis: [0, 1]", "axis: [0, 1 mm]", "modules[2].axis[2]: Expected `float`, got `str` (given: '1 mm')"),
        ("10 cm", "10 furlong", "modules[1].link.position[2]: Expected `float`, got `str` (given: '10 furlong')"),
    ],
)  # fmt: skip
def test_a_number_in_another_unit_is_told(tmp_path: Path, old: str, new: str, fault: str) -> None:
    assert fault in faults(tmp_path, FILE.replace(old, new))


@given(st.sampled_from(NAMES), st.sampled_from(NAMES), st.floats(1e-3, 1e3))
def test_a_length_is_the_same_in_each_unit(unit: str, other: str, length: float) -> None:
    there = length * MILLIMETRES[unit] / MILLIMETRES[other]
    (lengths,) = (known for known in factors(other).values() if "mm" in known)
    assert value_in(f"{length!r} {unit}", lengths) == pytest.approx(there)
    assert there * metres_of(other) == pytest.approx(length * metres_of(unit))


@given(st.text("0123456789.eE+- mdeg°\n", max_size=12))
def test_any_text_is_a_finite_number_or_none(text: str) -> None:
    value = value_in(text, factors("mm")["in radians"])
    assert value is None or abs(value) < 1e300


def test_a_file_without_a_unit_counts_as_metres_and_says_so() -> None:
    assert (metres_of(None), unit_name(None)) == (1.0, "unit of the arm's file")
    with pytest.raises(ValueError, match="'ft' is none of m, cm, mm, in"):
        metres_of("ft")


def test_a_unit_changes_no_number_of_the_arm(tmp_path: Path) -> None:
    plain = yaml.safe_load(FILE.replace("10 cm", "100").replace("50 mm", "50").replace("1 m,", "1000,"))
    plain["obstacles"][0]["disc"]["radius"] = 25.4
    del plain["unit"]
    with_unit = load(written(tmp_path, FILE)).manipulator.frames
    assert load(written(tmp_path, yaml.safe_dump(plain))).manipulator.frames == pytest.approx(with_unit)


def test_a_number_with_a_unit_is_refused_outside_of_files() -> None:
    told: list[str] = []
    assert check({"centre": ["20 mm", 0], "radius": 1}, RoundSettings, told) is None
    assert told == [
        "centre[0]: Expected `float`, got `str` (given: '20 mm'); write a number without a unit: all lengths of a file"
        " have the same one"
    ]
