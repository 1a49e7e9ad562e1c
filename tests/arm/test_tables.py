"""Measured frames: written and read back, and every fault by its line."""

import csv
import io

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from hyperbit.controller.arm.tables import PLANAR, SPATIAL, read_table
from hyperbit.controller.manipulator import frames
from tests.arms import planar_frames, spatial_frames


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("tables")


def read(folder, text: str | bytes):
    faults: list[str] = []
    (folder / "m.csv").write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_table(folder, "m.csv", "here", faults), faults


def written(stack, columns) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, columns)
    writer.writeheader()
    for f in stack:
        x, y, z = f[:3, 3].tolist()
        qx, qy, qz, qw = frames.quaternion(f).tolist()
        every = {"x": x, "y": y, "z": z, "th": frames.angle(f), "qx": qx, "qy": qy, "qz": qz, "qw": qw}
        writer.writerow({name: every[name] for name in columns})
    return text.getvalue()


@given(st.lists(planar_frames, min_size=2, max_size=9), st.permutations(PLANAR))
def test_planar_frames_read_back(folder, stack, columns):
    table, faults = read(folder, written(stack, columns))
    assert (faults, table.planar) == ([], True)
    assert_allclose(table.frames, stack, atol=1e-12)


@given(st.lists(spatial_frames, min_size=2, max_size=9), st.permutations(SPATIAL))
def test_spatial_frames_read_back(folder, stack, columns):
    table, faults = read(folder, written(stack, columns))
    assert (faults, table.planar) == ([], False)
    assert_allclose(table.frames, stack, atol=1e-9)


def test_spreadsheets_write_marks_spaces_and_empty_lines(folder):
    table, faults = read(folder, b'\xef\xbb\xbfx, y, th\r\n0, 1, 0.5\r\n\r\n"1", 2e0, -0.5\r\n')
    assert faults == []
    assert_allclose(table.frames, [frames.planar(0, 1, 0.5), frames.planar(1, 2, -0.5)], atol=0)


def test_measured_quaternions_are_made_unit(folder):
    table, _ = read(folder, "x,y,z,qx,qy,qz,qw\n0,0,1,0,0,0.6004,0.8\n0,0,1,0,0,0,-1\n")
    assert_allclose(table.frames[0][:3, :3] @ table.frames[0][:3, :3].T, np.eye(3), atol=1e-12)
    assert_allclose(table.frames[1][:3, :3], np.eye(3), atol=0)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", ["columns x,y,th or x,y,z,qx,qy,qz,qw are needed, got none"]),
        ("x,y\n0,1\n", ["columns x,y,th or x,y,z,qx,qy,qz,qw are needed, got x,y"]),
        ("x,y,th,th\n0,1,0,0\n", ["column 'th' occurs twice"]),
        ("x,y,th\n0,1,0\n0,1,0,0\n", ["line 3: 3 fields are needed, got 4"]),
        ("0,0.1,2\n0,0.2,0\n", ["columns x,y,th or x,y,z,qx,qy,qz,qw are needed, got 0,0.1,2"]),
        ("x,y,th\n", ["2 to 4096 rows are needed, a state each, got 0"]),
        ("x,y,th\n0,1,0\n", ["2 to 4096 rows are needed, a state each, got 1"]),
        ("x,y,th\n" + "0,1,0\n" * 5000, ["2 to 4096 rows are needed, a state each, got 4097"]),
        (
            'x,y,th\n0,1\n"0,3",1,0\n0,a,0\n0,1,0\n,1_0,0\n0,1_0,0\n',
            [
                "line 2: th: a number is needed, got ''",
                "line 3: x: a number is needed, got '0,3'; write a decimal point: 0.3",
                "line 4: y: a number is needed, got 'a'",
                "line 6: x: a number is needed, got ''",
                "line 7: y: a number is needed, got '1_0'",
            ],
        ),
        (
            "x,y,th\n0,nan,0\n0,1,inf\n1e7,1,0\n0,1,15\n",
            [
                "line 2: y: a number is needed, got 'nan'",
                "line 3: th: a number is needed, got 'inf'",
                "line 4: x: a number from -1e+06 to 1e+06 is needed, got '1e7'",
                "line 5: th: a number from -12.5664 to 12.5664 is needed, got '15'; in radians, 15 degrees are 0.2618",
            ],
        ),
        (
            "x,y,z,qx,qy,qz,qw\n0,0,1,0,0,0,0\n0,0,1,0,0,0,1\n",
            ["line 2: a quaternion qx, qy, qz, qw of length 1 is needed, got [0.0, 0.0, 0.0, 0.0]"],
        ),
        (b"x,y,th\n\xff,0,0\n", ["cannot be read: 'utf-8' codec can't decode"]),
        ('x,y,th\n"0,0,0\n', ["cannot be read: unexpected end of data"]),
    ],
    ids=lambda value: str(value)[:40],
)
def test_each_fault_is_named_by_its_line(folder, text, expected):
    table, faults = read(folder, text)
    assert table is None
    assert len(faults) == len(expected)
    for fault, words in zip(faults, expected, strict=True):
        assert fault.startswith("here: m.csv")
        assert fault.removeprefix("here: m.csv").lstrip(": ").startswith(words)


@given(st.text('xyth,0123.-e\n" q', max_size=60) | st.binary(max_size=60))
def test_any_file_is_read_or_refused_in_words(folder, text):
    table, faults = read(folder, text if isinstance(text, bytes) else f"x,y,th\n{text}")
    assert (table is None) == bool(faults)


def test_a_folder_is_no_table(folder):
    faults: list[str] = []
    (folder / "folder.csv").mkdir()
    assert read_table(folder, "folder.csv", "here", faults) is None
    assert faults == ["here: folder.csv cannot be read: it is a directory, no file"]
    assert read_table(folder, "nul\0.csv", "here", faults) is None
