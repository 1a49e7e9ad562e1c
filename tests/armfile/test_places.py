"""Faults name the line of the arm's file, and count list positions from 1."""

import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from hyperbit.controller.arm.arm import load
from hyperbit.controller.armfile.places import place, placed_faults
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.executor.arm.arm import read_arm

TEXT = """\
name: finger
modules:
  - {type: vgt, count: 2, width: 0.2, lengths: [0.2, 0.25]}
tolerance: {position: 0.002}
travel_time: 0.1
method: pop
boards:
  heartbeat: 0.1
  on_loss: hold
buses:
  - {name: can0, channel: can0}
actuators:
  - {module: 1, actuator: left, bus: can0, node: 1, output: 0}
  - {module: 1, actuator: diagonal, bus: can0, node: 1, output: 1}
  - module: 1
    actuator: right
    bus: can0
    node: 1
    output: 2
  - {module: 2, actuator: left, bus: can0, node: 2, output: 0}
  - {module: 2, actuator: diagonal, bus: can0, node: 2, output: 1}
  - {module: 2, actuator: right, bus: can0, node: 2, output: 2}
"""


def fault(folder: Path, old: str, new: str, read=load) -> str:
    """Returns the message of the file with a text replaced, without the path of the file."""
    path = folder / "arm.yaml"
    assert old in TEXT
    path.write_text(TEXT.replace(old, new))
    with pytest.raises(InputFaults) as caught:
        read(path)
    return str(caught.value).removeprefix(f"{path}, line ")


def test_the_file_is_right(tmp_path):
    (tmp_path / "arm.yaml").write_text(TEXT)
    assert len(load(tmp_path / "arm.yaml").wiring) == 6


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("type: vgt", "type: vtg", "3: modules[1].type: 'vtg' is unknown; did you mean 'vgt'? It must"),
        ("method: pop", "method: min-switch", "6: method: 'min-switch' is unknown; did you mean 'minimum-"),
        ("on_loss: hold", "on_loss: off", "9: boards.on_loss: false, but it must be one of hold, contract; YAML"),
        ("e: 0.1\n", "e: 100mm\n", "5: travel_time: Expected `float | object`, got `str` (given: '100mm'); this"),
        ("  heartbeat", "  hartbeat", "8: boards.hartbeat: unknown field; did you mean 'heartbeat'? Known are"),
        ("name: finger\n", "name: a b\n", "1: name: Expected `str` of 1 to 64"),
        ("{position: 0.002}", "{}", "4: tolerance.position: required, but missing"),
        ("[0.2, 0.25]", "[0.2, x]", "3: modules[1].lengths[2]: Expected `float`, got `str`"),
        # Faults that only the wiring, the geometry or the layout show.
        ("    output: 2", "    output: 1", "19: actuators[3].output: output 1 of can0/1 is 1.diagonal's already"),
        ("    bus: can0", "    bus: can1", "17: actuators[3].bus: 'can1' is none of the buses can0"),
        ("  - {module: 2, actuator: right, bus: can0, node: 2, output: 2}\n", "", "12: actuators: 2.right is not"),
        ("[0.2, 0.25]", "[0.25, 0.2]", "3: modules[1].lengths: left is 0.25 contracted, so not 0.2 extended"),
        ("heartbeat: 0.1", "heartbeat_timeout: 0.1", "8: boards.heartbeat_timeout: 0.1 s is too short"),
        ("heartbeat: 0.1", "heartbeat: 1", "7: boards.heartbeat_timeout: 0.35 s is too short"),
        ("buses:\n", "buses: [\n", "11: is not YAML: while parsing a flow node"),
        ("method: pop", "name: again", "6: is not YAML: 'name' occurs twice"),
    ],
    ids=lambda text: text.strip()[:28],
)  # fmt: skip
def test_a_fault_names_its_line(tmp_path, old, new, expected):
    assert fault(tmp_path, old, new).splitlines()[0].startswith(expected)


def test_the_executor_names_the_same_lines(tmp_path):
    assert fault(tmp_path, "    bus: can0", "    bus: can1", read_arm) == fault(
        tmp_path, "    bus: can0", "    bus: can1"
    )


def test_a_process_prints_the_line(tmp_path):
    (tmp_path / "arm.yaml").write_text(TEXT.replace("type: vgt", "type: vtg"))
    words = [sys.executable, "-m", "hyperbit.controller.executor", str(tmp_path / "arm.yaml"), "--simulate"]
    assert (
        "arm.yaml, line 3: modules[1].type: 'vtg' is unknown"
        in subprocess.run(words, capture_output=True, text=True).stderr
    )


@pytest.mark.parametrize("name", ["a b", "a.b", "off", "7", "x: y", "é" * 90], ids=lambda name: name[:8])
def test_odd_names_have_lines_too(tmp_path, name):
    path = tmp_path / "arm.yaml"
    path.write_text(f"first: 1\n{yaml.safe_dump({name: 1}, allow_unicode=True)}")
    assert place(path, [f"{name:.80}: unknown field"]) == [(f"{name:.80}: unknown field", 2)]


def test_a_name_that_begins_like_another_is_no_match(tmp_path):
    (tmp_path / "arm.yaml").write_text("heart: 1\nheartbeat: 2\n")
    assert [
        fault.line for fault in place(tmp_path / "arm.yaml", ["heartbeat: wrong", "heart: wrong", "hear: wrong"])
    ] == [2, 1, None]


def test_faults_are_placed_once(tmp_path):
    path = tmp_path / "arm.yaml"
    path.write_text("a: [1, 2]\n")
    with pytest.raises(InputFaults) as caught, placed_faults(path), placed_faults(path):
        raise InputFaults(path, ["a[0]: wrong", "b: missing"])
    assert str(caught.value) == f"{path}, line 1: a[1]: wrong\n{path}: b: missing"


PATHS = st.text("ab.[]0123: -'é", max_size=30)


@given(text=st.text("ab:-[]{}&*!|>'\"#,? \n1.~%@`", max_size=40), fault=PATHS)
def test_whatever_is_wrong_a_line_is_named_or_none(tmp_path_factory, text, fault):
    path = tmp_path_factory.getbasetemp() / "any.yaml"
    path.write_text(text)
    [placed] = place(path, [fault])
    assert placed.line is None or 1 <= placed.line <= text.count("\n") + 1
    assert bool(placed.text) == bool(fault)


@given(lines=st.lists(st.sampled_from(TEXT.splitlines()), max_size=25), cut=st.integers(0, 60), data=st.data())
def test_any_mixture_of_lines_is_read_or_refused(tmp_path_factory, lines, cut, data):
    """Lines of a right file, in another order, some missing or cut short."""
    path = tmp_path_factory.getbasetemp() / "mixture.yaml"
    kept = lines or data.draw(st.permutations(TEXT.splitlines()))
    path.write_text("\n".join([*kept[:-1], kept[-1][:cut]]) + "\n")
    faults, lines = loaded(path)
    assert len(lines) == len(faults)
    assert all(line is None or 1 <= line <= len(kept) + 1 for line in lines)


def loaded(path: Path) -> tuple[tuple[str, ...], tuple[int | None, ...]]:
    try:
        load(path)
    except InputFaults as error:
        return error.faults, error.lines
    return (), ()
