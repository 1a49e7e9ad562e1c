"""Wiring in a CSV file: the same actuators as rows of the arm's file, and each fault with its line."""

from pathlib import Path

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from hyperbit.controller.arm.arm import load
from hyperbit.controller.arm.description import file
from hyperbit.controller.armfile.actuators import read_wired
from hyperbit.controller.armfile.patience import patient_copy
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.armfile.terminals import owned_terminals
from hyperbit.controller.armfile.wiring_table import cell_value, wiring_cell

ARM = {
    "name": "short",
    "modules": [{"type": "vgt", "width": 0.2, "lengths": [0.2, 0.25]}],
    "tolerance": {"position": 0.002},
    "buses": [{"name": "can0", "channel": "can0"}, {"name": "can1", "channel": "can1"}],
}
ROWS = [
    {"module": 1, "actuator": "left", "bus": "can0", "node": 1, "output": 0, "input": 0},
    {"module": 1, "actuator": "diagonal", "bus": "can0", "node": 1, "output": {"bit": 2, "inverted": True}}
    | {"output_off": 3, "pulse": 0.05, "input": {"bit": 4, "inverted": True, "board": "can1/9"}},
    {"module": 1, "actuator": "right", "bus": "can0", "node": 1, "output": 4, "travel_time": 0.08, "stuck": "extended"},
]  # fmt: skip
TABLE = """\
module,actuator,bus,node,output,output_off,pulse,input,travel_time,stuck
1,left,can0,1,0,,,0,,

1,diagonal,can0,1,2 inverted,3,50 ms,can1/9:4 inverted,,
1, right ,can0,1,4,,,,0.08,extended
"""


def written(folder: Path, table: str, **more: object) -> Path:
    path = folder / "arm.yaml"
    path.write_text(yaml.safe_dump({**ARM, "wiring": "wires.csv", **more}))
    (folder / "wires.csv").write_text(table)
    return path


def test_a_table_is_the_same_as_rows_in_the_file(tmp_path: Path) -> None:
    path = written(tmp_path, TABLE)
    plain = tmp_path / "plain.yaml"
    plain.write_text(yaml.safe_dump({**ARM, "actuators": ROWS}))
    for first, second in zip(load(path).wiring, load(plain).wiring, strict=True):
        bits = {name: getattr(first, name) for name in ("pulse", "travel_time", "stuck", "module", "actuator", "node")}
        assert bits == {name: getattr(second, name) for name in bits}
    own, other = (read_wired(it)[0] for it in (path, plain))
    assert [it.terminal for it in owned_terminals(own)] == [it.terminal for it in owned_terminals(other)]


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ("2 inverted", "2 invert", "wiring: wires.csv line 4: output: Expected `int | object`, got `str`"),
        ("1,left", "x,left", "wiring: wires.csv line 2: module: Expected `int`, got `str` (given: 'x')"),
        ("1,left", ",left", "wiring: wires.csv line 2: module: required, but missing"),
        ("left", "top", "wiring: wires.csv line 2: actuator: 'top', but module 1 has left, diagonal, right"),
        ("can0,1,4", "can0,1,2", "wiring: wires.csv line 5: output: output 2 of can0/1 is 1.diagonal's already"),
        ("can0,1,4", "can5,1,4", "wiring: wires.csv line 5: bus: 'can5' is none of the buses can0, can1"),
        ("50 ms", "50 mm", "wiring: wires.csv line 4: pulse: Expected"),
        ("pulse", "puls", "wiring: wires.csv: puls: unknown field; did you mean 'pulse'?"),
        ("0.08,extended", "0.08,extended,5", "wiring: wires.csv line 5: 10 fields are needed, got 11"),
        (TABLE, "module,actuator", "wiring: wires.csv: a row for each actuator is needed, got none"),
        ("1,left,can0,1,0,,,0,,", "", "actuators: 1.left is not mapped"),
    ],
)  # fmt: skip
def test_a_fault_names_file_and_line(tmp_path: Path, old: str, new: str, fault: str) -> None:
    with pytest.raises(InputFaults) as caught:
        load(written(tmp_path, TABLE.replace(old, new)))
    assert fault in str(caught.value)


def test_wiring_stands_in_one_place(tmp_path: Path) -> None:
    with pytest.raises(InputFaults, match=r"wiring: wires\.csv, but the file has actuators, too"):
        load(written(tmp_path, TABLE, actuators=ROWS))
    with pytest.raises(InputFaults, match="a CSV file beside the arm's is needed, such as"):
        load(written(tmp_path, TABLE, wiring="../wires.csv"))
    with pytest.raises(InputFaults, match=r"wiring: other\.csv cannot be read: No such file"):
        load(written(tmp_path, TABLE, wiring="other.csv"))


def test_copies_of_the_file_have_the_table(tmp_path: Path) -> None:
    path, folder = written(tmp_path, TABLE), tmp_path / "copy"
    folder.mkdir()
    assert len(load(patient_copy(path, folder)).wiring) == 3
    told = file(load(path))
    assert told is not None
    assert told.tables == {"wires.csv": TABLE}


@given(st.integers(0, 2031), st.booleans(), st.none() | st.just("can1/9"))
def test_a_written_cell_is_read_back(bit: int, inverted: bool, board: str | None) -> None:
    found = cell_value("input", wiring_cell(bit, inverted=inverted, board=board))
    assert (found["bit"], found["inverted"], found.get("board")) == (bit, inverted, board)


@given(st.sampled_from(("output", "node", "bus", "pulse")), st.text(max_size=12))
def test_any_cell_has_a_value(column: str, cell: str) -> None:
    assert isinstance(cell_value(column, cell), str | int | float | dict)
