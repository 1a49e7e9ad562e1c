"""Methods from files of users: they are pickled with their source, so the file may be gone."""

from __future__ import annotations

import pickle

import pytest

from hyperbit.controller.bench.arm import bench_arm
from hyperbit.controller.bench.methods import find_method

SOURCE = """
from __future__ import annotations
import pickle
from dataclasses import dataclass

@dataclass
class Found:
    configuration: object
    other: Found | None = None

def prepare(arm):
    return lambda goal, start: pickle.loads(pickle.dumps(Found(start))).configuration
"""


@pytest.fixture
def file(tmp_path):
    file = tmp_path / "v1.0" / "json.py"
    file.parent.mkdir()
    file.write_text(SOURCE)
    return file


def test_a_pickled_method_needs_no_file(file):
    sent = pickle.dumps(find_method(f"{file}:prepare"))
    file.unlink()
    assert pickle.loads(sent)(bench_arm("planar16"))("goal", "start") == "start"


def test_a_file_with_the_name_of_a_module_does_not_replace_it(file):
    import json

    find_method(f"{file}:prepare")
    import json as later

    assert later is json


def test_a_file_that_fails_is_named(file):
    file.write_text("import missing_here\n")
    with pytest.raises(ValueError, match=r"json\.py cannot be imported: ModuleNotFoundError: No module named 'missing"):
        find_method(f"{file}:prepare")
    file.write_text("raise SystemExit(3)\n")
    with pytest.raises(ValueError, match=r"json\.py cannot be imported: SystemExit: 3"):
        find_method(f"{file}:prepare")
