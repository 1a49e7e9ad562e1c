"""CSV files: columns, line numbers, limits and faults."""

import pytest

from hyperbit.controller.armfile.csv_files import CsvRow, read_csv
from hyperbit.controller.armfile.strict import InputFaults


def test_rows_have_the_numbers_of_their_lines(tmp_path):
    path = tmp_path / "goals.csv"
    path.write_text('\ufeffx, y\n1, 2\n\n"3\n", 4\n5, 6\n')
    file = read_csv(path)
    assert file.columns == ["x", "y"]
    assert file.rows == [CsvRow(2, ["1", "2"]), CsvRow(5, ["3\n", "4"]), CsvRow(6, ["5", "6"])]
    assert len(read_csv(path, 1).rows) == 2


def test_a_row_may_end_before_its_last_columns(tmp_path):
    path = tmp_path / "goals.csv"
    path.write_text("x,y\n1\n")
    assert read_csv(path).rows == [CsvRow(2, ["1", ""])]


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("x,y\n1,2\n0,3,2,8\n", "line 3: 2 fields are needed, got 4; a number has a decimal point, such as 0.3"),
        ("x,y\n0.5,2.8,\n", "line 2: 2 fields are needed, got 3"),
        ("x,y,x\n0.5,2.8,0.2\n", "column 'x' occurs twice"),
        ("x;y\n0,3;2,8\n", "semicolons separate the columns: write commas, and numbers with a decimal point"),
        ("x\ty\n1\t2\n", "tabs separate the columns"),
        ('{"waypoints": [{"position": [0.5, 2.9]}]}', "a CSV file is needed; this file looks like JSON"),
    ],
)
def test_what_could_be_read_in_two_ways_is_refused(tmp_path, text, fault):
    path = tmp_path / "goals.csv"
    path.write_text(text)
    with pytest.raises(InputFaults) as caught:
        read_csv(path)
    assert fault in str(caught.value)


@pytest.mark.parametrize("content", [None, b"\xff\xfe", b'x\n"1"2\n', b"x" * 200_000])
def test_an_unreadable_file_is_named(tmp_path, content):
    path = tmp_path / "goals.csv"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputFaults, match=r"goals\.csv: cannot be read: "):
        read_csv(path)
