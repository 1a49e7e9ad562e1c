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
    assert len(read_csv(path, 1).rows) == 1, "the empty line counts"
    assert len(read_csv(path, 2).rows) == 2


def test_records_have_each_column(tmp_path):
    path = tmp_path / "goals.csv"
    path.write_text("x,y\n1\n1,2,3\n")
    assert list(read_csv(path).records()) == [(2, {"x": "1", "y": ""}), (3, {"x": "1", "y": "2"})]


@pytest.mark.parametrize("content", [None, b"\xff\xfe", b'x\n"1"2\n'])
def test_an_unreadable_file_is_named(tmp_path, content):
    path = tmp_path / "goals.csv"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputFaults, match=r"goals\.csv: cannot be read: "):
        read_csv(path)
