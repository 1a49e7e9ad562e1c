"""A new arm's file: each kind of answer gives a file without fault; the same answers give the same file."""

from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyperbit.controller.arm.arm import load
from hyperbit.controller.armfile.module_texts import KINDS, default_text, parse_module
from hyperbit.controller.armfile.new_file import VALVES, Answers, new_file, table_name
from hyperbit.controller.armfile.terminals import owned_terminals
from hyperbit.controller.armfile.units import NAMES
from hyperbit.controller.executor.arm.arm import read_arm

SEGMENT = ("prismatic strokes=25,50 link=60", "revolute angles=-30,30 link=40")


def written(folder: Path, answers: Answers) -> Path:
    path = folder / "lift.yaml"
    made = new_file(answers, path, "hyperbit new lift.yaml")
    path.write_text(made.text)
    if made.table is not None:
        (folder / table_name(path)).write_text(made.table)
    return path


def test_thirty_actuators_share_five_boards_evenly(tmp_path: Path) -> None:
    arm = load(written(tmp_path, Answers("lift", SEGMENT, repeat=10, boards=5)))
    assert (len(arm.manipulator.modules), len(arm.wiring), arm.settings.unit) == (20, 30, "mm")
    assert [sum(entry.node == node for entry in arm.wiring) for node in range(1, 6)] == [6] * 5
    assert arm.manipulator.frames[1, 1, :2, 3] == pytest.approx([-20.0, 34.641016])


def test_a_module_has_its_defaults_in_each_unit(tmp_path: Path) -> None:
    lengths = {
        unit: load(written(tmp_path, Answers("a", ("vgt", "stewart"), unit=unit))).manipulator.length for unit in NAMES
    }
    assert lengths["m"] * 1000 == pytest.approx(lengths["mm"], rel=1e-3)
    assert lengths["in"] * 25.4 == pytest.approx(lengths["mm"], rel=1e-3)


@settings(deadline=None, max_examples=20)
@given(
    st.lists(st.sampled_from(sorted(KINDS)), min_size=1, max_size=2, unique=True),
    st.sampled_from(NAMES),
    st.integers(1, 3),
    st.sampled_from(sorted(VALVES)),
    st.sampled_from(["none", "extended", "both"]),
    st.integers(2, 24),
    st.booleans(),
    st.sampled_from(["rows", "csv"]),
    st.booleans(),
)
def test_the_file_of_any_answers_is_right(
    tmp_path_factory, kinds, unit, repeat, valves, stops, outputs, island, wiring, plain
) -> None:
    folder = tmp_path_factory.mktemp("new")
    answers = Answers("a", tuple(kinds), unit, repeat, valves=valves, end_stops=stops, outputs=outputs, island=island)
    answers = answers._replace(wiring=wiring, error_state="none" if plain else "off")
    path = written(folder, answers)
    arm = load(path)
    read_arm(path)
    assert len(arm.wiring) == len(arm.manipulator.actuators)
    used = [(it.terminal.kind, it.terminal.board, it.terminal.bit) for it in owned_terminals(arm.settings)]
    assert len(set(used)) == len(used)
    assert max(bit for kind, _, bit in used if kind == "output") < outputs
    assert new_file(answers, path, "x") == new_file(answers, path, "x")


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("vtg", "'vtg' is no kind of module; did you mean 'vgt'? Known are prismatic, revolute, vgt, stewart"),
        ("vgt widht=3", "'widht' is no field of vgt; did you mean 'width'? Known are width, lengths, count"),
        ("vgt 200", "'200': a field and its value are needed, such as width=..."),
        ("vgt lengths=200", "lengths=200: 1 numbers, needed are 2, separated by commas"),
        ("vgt lengths=300,200", "lengths=300,200: contracted and then extended are needed, the second longer"),
        ("vgt width=0", "width=0: lengths above 0 are needed"),
        ("vgt width=20deg", "width: a length in mm, as 20 or 2cm, is needed, got '20deg'"),
        ("revolute angles=-30mm,3", "angles: an angle in degrees, as 30 or 0.5rad, is needed, got '-30mm'"),
        ("revolute angles=30,30", "angles=30,30: an angle occurs twice"),
        ("vgt count=0", "a whole number from 1 to 10000 is needed, got '0'"),
    ],
)
def test_a_wrong_module_is_told(text: str, fault: str) -> None:
    with pytest.raises(ValueError) as caught:  # noqa: PT011 - the whole sentence is compared below
        parse_module(text, "mm")
    assert str(caught.value).startswith(fault)


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        ({"boards": 3}, "3 boards, but 30 actuators need 4 to 30 boards of 8 outputs"),
        ({"boards": 31}, "31 boards, but 30 actuators need 4 to 30 boards"),
        ({"outputs": 1, "valves": "pair"}, "1 outputs a board, but an actuator needs 2"),
        ({"first_node": 124}, "4 boards from node 124 end at 127, but ids end at 126"),
        ({"modules": ()}, "modules: at least one is needed"),
    ],
)
def test_answers_without_room_are_told(changes: dict, fault: str) -> None:
    with pytest.raises(ValueError) as caught:  # noqa: PT011 - the whole sentence is compared below
        new_file(Answers("lift", SEGMENT, repeat=10)._replace(**changes), Path("lift.yaml"), "")
    assert str(caught.value).startswith(fault)


def test_names_that_yaml_reads_as_other_values_stand_in_quotes(tmp_path: Path) -> None:
    for name in ("on", "12", "010", "1e3", "null", "-a"):
        assert load(written(tmp_path, Answers(name, ("vgt",), bus="123"))).settings.name == name


def test_units_in_answers_are_those_of_the_file() -> None:
    parsed = parse_module("prismatic strokes=2cm,0.05m link=1in", "mm")
    assert (parsed["strokes"], parsed["link"]) == ([20.0, 50.0], [25.4])
    assert parse_module("revolute angles=-0.5rad,30deg", "m")["angles"] == pytest.approx([-28.6478898, 30.0])
    assert default_text(KINDS["vgt"].numbers["lengths"], "cm") == "20,25"
