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
    assert (told["positions"]["method"], told["locked"]["method"]) == ("listing", "mapping")
    assert all(told[part]["why"] for part in ("positions", "at", "locked"))
    covered, redundancy = told["positions"]["covered"], told["positions"]["log10_redundancy"]
    assert 0 < covered["lower"] <= covered["estimate"] <= covered["upper"] < covered["lower"] * 1.2
    assert 0 <= redundancy["lower"] <= redundancy["upper"] <= told["positions"]["log10_greatest_redundancy"]
    assert told["at"]["configurations"] > 0
    assert not [name for name in told["positions"] if name in told["at"] and name not in ("method", "why")]
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
    for words in ("by listing: ", "by mapping: ", "3 random choices", "log10_redundancy", "worst", str(picture)):
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


def test_figures_do_not_depend_on_the_pixel(hyperbit, tmp_path):
    told = []
    for pixel in ("0.005", "0.05"):
        file = tmp_path / "arm.yaml"
        file.write_text(PLANAR + f"workspace: {{pixel: {pixel}}}\n")
        code, out, _ = hyperbit("workspace", str(file), "--picture", str(tmp_path / "p.png"), "--json")
        assert code == 0
        told.append(json.loads(out)["positions"])
    for figure in ("covered", "log10_redundancy"):
        assert told[0][figure]["estimate"] == pytest.approx(told[1][figure]["estimate"], rel=0.1, abs=0.04)
