"""What `hyperbit check` and the executor say of end-stops on other boards, and of boards with too many bytes."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import yaml

from tests.arm_files import document
from tests.keys import DEPLOY


def written(folder: Path, value: dict[str, Any]) -> Path:
    path = folder / "arm.yaml"
    path.write_text(yaml.safe_dump(value))
    return path


def test_process_data_that_do_not_fit_are_refused_before_the_executor_starts(hyperbit, tmp_path):
    value = document(12)
    for k, entry in enumerate(value["actuators"]):
        entry.update(node=1, output=8 * k, input=None)
    path = written(tmp_path, value)
    said = "actuators[33].output: 256, but board can0/1: its outputs are in 36 bytes; 32 fit in four PDOs"
    code, out, _ = hyperbit("check", str(path), "--json")
    assert (code, json.loads(out)["faults"]) == (2, [said])
    executor = [sys.executable, "-m", "hyperbit.controller.executor", str(path), "--simulate"]
    run = subprocess.run(executor, capture_output=True, text=True)
    assert (run.returncode, "Traceback" in run.stderr) == (2, False), run.stderr
    assert said in run.stderr.replace("\n", " ")


def test_boards_of_end_stops_count_as_boards_of_the_arm(hyperbit, tmp_path):
    value = document()
    for k, entry in enumerate(value["actuators"]):
        entry["input"] = {"board": "can0/9", "bit": k}
    path = written(tmp_path, value)
    code, out, _ = hyperbit("check", str(path))
    assert (code, "6 actuators on 3 boards: no fault" in out.replace("\n", " ")) == (0, True), out
    code, _, err = hyperbit("simulate", str(path), "--board", "can0/8=standard")
    assert (code, "no board can0/8, there are can0/1, can0/2, can0/9" in err.replace("\n", " ")) == (2, True), err
    code, _, err = hyperbit("board", str(path), "can0/8", "errors")
    assert (code, "which has can0/1, can0/2, can0/9" in err.replace("\n", " ")) == (2, True), err


def test_check_draws_the_wiring_of_an_arm(hyperbit, tmp_path):
    file = tmp_path / "wiring.svg"
    code, _, err = hyperbit("check", str(DEPLOY / "motor12.yaml"), "--wiring", str(file))
    assert (code, err) == (0, "")
    assert "<svg" in file.read_text()
    code, _, err = hyperbit("check", str(DEPLOY / "motor12.yaml"), "--wiring", str(tmp_path / "wiring.txt"))
    assert (code, "cannot be written" in err) == (2, True)
