"""New numbers in a file: the values change, and all else stays."""

from __future__ import annotations

import math

import yaml
from hypothesis import given
from hypothesis import strategies as st

from hyperbit.controller.armfile.rewriting import rewritten

TEXT = """# An arm
name: a   # of the hall
modules:
  # of the shoulder
  - type: vgt
    count: 3            # three
    lengths: [0.20, 0.25]  # short, long
    width: 0.2

  - {type: revolute, angles: [-0.1, 0.3], link: {position: [0, 0.2]}}  # wrist
tolerance: {position: 0.002}
# the end
"""


def test_numbers_change_in_place_and_nothing_else_does():
    new = yaml.safe_load(TEXT)["modules"]
    new[0]["lengths"], new[0]["first_diagonal"] = [0.2, 0.26], "BC"
    new[1]["link"] = {"position": [1e-05, 0.21], "orientation": 0.01}
    places = {("modules", 0, "lengths", 0), ("modules", 0, "lengths", 1), ("modules", 1, "link", "orientation")}
    places |= {("modules", 1, "link", "position", k) for k in (0, 1)}
    assert rewritten(TEXT, {"modules": new}, places) == TEXT.replace("0.25", "0.26").replace(
        "{position: [0, 0.2]}", "{position: [1.0e-05, 0.21], orientation: 0.01}"
    )


def test_a_new_field_and_a_list_of_another_length_keep_the_rest():
    base, modules = {"position": [0.1, 0.2], "orientation": 0.5}, [{"type": "vgt", "count": 1}] * 3
    places = {("base", "position", 0), ("base", "orientation"), ("modules", 0, "count")}
    text = rewritten(TEXT, {"base": base, "modules": modules}, places)
    assert yaml.safe_load(text) == {**yaml.safe_load(TEXT), "base": base, "modules": modules}
    for kept in (
        "# An arm",
        "# of the hall",
        "# of the shoulder",
        "# the end",
        "tolerance: {position: 0.002}",
    ):
        assert kept in text


def test_numbers_keep_their_units():
    text = "unit: mm\nmodules:\n- {type: revolute, angles: [-30 deg, 0.3, 0 °], link: {position: [2 cm, 3.5]}}\n"
    new = {"type": "revolute", "angles": [-math.pi / 6, 0.31, math.pi / 180], "link": {"position": [20.1, 3.5]}}
    places = {("modules", 0, "angles", k) for k in (0, 1, 2)} | {("modules", 0, "link", "position", 0)}
    changed = text.replace("0.3,", "0.31,").replace("0 °", "1 °").replace("2 cm", "2.01 cm")
    assert rewritten(text, {"modules": [new]}, places) == changed


numbers = st.floats(-1e6, 1e6, allow_subnormal=False)
values = st.recursive(numbers, lambda part: st.lists(part, max_size=3) | st.dictionaries(st.sampled_from("abc"), part))


@given(values, values, st.booleans())
def test_what_is_read_back_is_what_was_written(before, after, block):
    text = yaml.safe_dump({"name": "x", "v": before, "w": 1.5}, default_flow_style=not block, sort_keys=False)
    places = set(leaves(("v",), after)) | {("v",)}
    read = yaml.safe_load(rewritten(text, {"v": after}, places))
    assert read["name"] == "x"
    assert read["w"] == 1.5
    assert has(read["v"], after)


def leaves(place, value):
    yield place
    for key, part in value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ():
        yield from leaves((*place, key), part)


def has(read, value):
    if isinstance(value, dict) and isinstance(read, dict):
        return all(has(read[key], part) for key, part in value.items())
    if isinstance(value, list) and isinstance(read, list):
        return len(read) == len(value) and all(map(has, read, value))
    return read == value
