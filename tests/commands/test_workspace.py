"""The command workspace: figures, pictures and refused options."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

PLANAR = """
name: short
modules: [{type: vgt, count: 5, width: 0.2, lengths: [0.2, 0.25]}]
tolerance: {position: 0.01}
"""
SPATIAL = """
name: solid
modules:
  - {type: revolute, count: 6, axis: [1, 0, 0], angles: [-0.5, 0.5], link: {position: [0, 0, 0.2]}}
  - {type: revolute, count: 6, axis: [0, 1, 0], angles: [-0.5, 0.5], link: {position: [0, 0, 0.2]}}
tolerance: {position: 0.2}
"""


@pytest.fixture(params=[(PLANAR, "0.1,0.95"), (SPATIAL, "0.2,0.1,2.1")], ids=["planar", "spatial"])
def arm(request, tmp_path) -> tuple[str, str, Path]:
    file = tmp_path / "arm.yaml"
    file.write_text(request.param[0])
    return str(file), request.param[1], tmp_path / "picture.png"


def test_positions_orientations_and_locks(hyperbit, arm):
    file, point, picture = arm
    arguments = ("--at", point, "--locked", "1", "--picture", str(picture))
    code, out, _ = hyperbit("workspace", file, *arguments, "--json")
    told = json.loads(out)
    assert code == 0
    assert {told["positions"]["method"], told["locked"]["method"]} == {"mapping"}
    assert all(told[part]["why"] for part in ("positions", "at", "locked"))
    assert 0 < told["positions"]["covered"] <= told["positions"]["reach"]
    assert told["at"]["configurations"] > 0
    shares = told["at"]["angles"] if "angles" in told["at"] else told["at"]["twists"]
    assert sum(shares) == pytest.approx(1)
    worst, locked = told["locked"]["worst"]["reach"], told["locked"]
    assert worst["reach"] == min(choice["reach"] for choice in locked["choices"])
    assert worst["reach"] <= locked["mean"]["reach"] <= locked["free"]["reach"] * 1.05
    assert len(worst["locked"]) == 1
    assert picture.stat().st_size > 10_000


def test_the_table_names_its_method_and_the_reason(hyperbit, arm):
    file, point, picture = arm
    code, out, _ = hyperbit(
        "workspace", file, "--at", point, "--locked", "2", "--samples", "3", "--picture", str(picture)
    )
    assert code == 0
    for words in ("by mapping: ", "3 random choices", "redundancy", "worst", str(picture)):
        assert words in out


def test_a_point_out_of_reach_has_no_orientations(hyperbit, arm):
    file, point, picture = arm
    far = ",".join(["9"] * (point.count(",") + 1))
    code, out, _ = hyperbit("workspace", file, "--at", far, "--picture", str(picture), "--json")
    told = json.loads(out)["at"]
    assert (code, told["configurations"], told["mean"]) == (0, 0, None)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--at", "1"), "'1' is no goal"),
        (("--at", "0,1,0.5"), "a position of 2 numbers is needed"),
        (("--locked", "0"), "1 to 15 actuators can be locked, not 0"),
        (("--locked", "16"), "1 to 15 actuators can be locked, not 16"),
        (("--samples", "0"), "0 is not from 1 to 10000"),
        (("--tolerance", "0"), "0 is no length"),
        (("--picture", "picture.docx"), "cannot be written"),
    ],
)
def test_unusable_input(hyperbit, tmp_path, arguments, message):
    file = tmp_path / "arm.yaml"
    file.write_text(PLANAR)
    code, _, err = hyperbit("workspace", str(file), "--picture", str(tmp_path / "p.png"), *arguments)
    assert code == 2
    assert message in err
