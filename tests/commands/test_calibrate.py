"""The command calibrate: written files and refused input."""

from __future__ import annotations

import json
import queue
import re
import threading
from pathlib import Path

import numpy as np
import pytest
import yaml

from hyperbit.controller.arm.arm import load
from hyperbit.controller.commands.connection import connected
from hyperbit.controller.manipulator import frames
from hyperbit.controller.manipulator.notation import format_configuration, parse_configuration
from tests.calibration.making import ARMS, arm_of, erring, measured
from tests.commands.conftest import ARM

pytestmark = pytest.mark.timeout(600)  # a calibration is twelve fits: seconds alone, minutes beside other programs
SPATIAL = "configuration,x,y,z,qx,qy,qz,qw"


@pytest.fixture
def files(request, tmp_path):
    """An arm's file, and one of what was measured of the real arm: of mixed modules, unless a test says which."""
    modules = getattr(request, "param", "mixed")
    arm, rng = arm_of(tmp_path, ARMS[modules], travel_time=0.2), np.random.default_rng(1)
    samples, m = measured(arm, erring(arm, rng), rng, 80), arm.manipulator
    lines = ["configuration,x,y,th" if m.planar else SPATIAL]
    for configuration, tip in zip(samples.configurations, samples.tips, strict=True):
        turn = [frames.angle(tip)] if m.planar else frames.quaternion(tip).tolist()
        numbers = map(repr, [*tip[: m.dimension, 3].tolist(), *turn])
        lines.append(f'"{format_configuration(m, configuration)}",{",".join(numbers)}')
    (tmp_path / "samples.csv").write_text("\n".join(lines) + "\n")
    return str(tmp_path / "arm.yaml"), str(tmp_path / "samples.csv")


@pytest.mark.parametrize("files", ["platforms"], indirect=True)
def test_the_new_file_is_an_arm_that_meets_the_samples(hyperbit, files, tmp_path):
    arm, samples = files
    new = tmp_path / "new.yaml"
    code, out, _ = hyperbit("calibrate", arm, samples, "--out", str(new), "--json")
    told = json.loads(out)
    assert (code, told["out"]) == (0, str(new))
    assert told["held_out"]["position"]["rms"] < 0.1 * told["before"]["position"]["rms"]
    assert hyperbit("check", str(new))[0] == 0
    before, after = (yaml.safe_load(Path(name).read_text()) for name in (arm, new))
    assert {key: before[key] for key in ("name", "tolerance", "travel_time")}.items() <= after.items()
    manipulator, off = load(new).manipulator, []
    for row in Path(samples).read_text().splitlines()[1:]:
        text, _, numbers = row[1:].partition('",')
        configuration = [int(state) for state in (text.split(",") if "," in text else text)]
        tip = manipulator.tip(configuration)[: manipulator.dimension, 3]
        off.append(np.linalg.norm(tip - np.array(numbers.split(",")[: len(tip)], dtype=float)))
    assert np.sqrt(np.mean(np.square(off))) == pytest.approx(told["after"]["position"]["rms"], rel=1e-4)


def test_existing_files_are_not_overwritten(hyperbit, files, tmp_path):
    arm, samples = files
    before = Path(arm).read_text()
    code, out, err = hyperbit("calibrate", arm, samples, "--out", arm)
    assert (code, out, Path(arm).read_text()) == (2, "", before)
    assert "the file exists" in err
    code, out, _ = hyperbit("calibrate", arm, samples, "--out", arm, "--force")
    assert (code, Path(arm).read_text() != before) == (0, True)
    assert all(words in out for words in ("80 samples", "held out", "modules[1].lengths[2]", "base.position[1]"))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["arm.yaml", "arm.yaml.old", "samples.csv"]
    assert Path(f"{arm}.old").read_text() == before
    newer = tmp_path / "newer.yaml"
    code, out, err = hyperbit("calibrate", arm, samples, "--out", str(newer), "--json")
    assert (code, json.loads(out)["better"], json.loads(out)["out"]) == (1, False, None)
    assert ("no better" in err, newer.exists()) == (True, False)


def test_faults_of_samples_are_unusable_input(hyperbit, files, tmp_path):
    arm, samples = files
    few, rows = tmp_path / "few.csv", Path(samples).read_text().splitlines(True)
    for text, sentence in (
        ("".join(rows[:8]), "few.csv: 7 samples, at least 10 are needed"),
        ("x\n", "columns configuration or actuators"),
    ):
        few.write_text(text)
        code, out, err = hyperbit("calibrate", arm, str(few), "--json")
        assert (code, out, sentence in err) == (2, "", True), err


@pytest.mark.parametrize("files", ["groups"], indirect=True)
def test_the_base_or_a_part_alone_is_fitted(hyperbit, files, tmp_path):
    arm, samples = files
    code, out, _ = hyperbit("calibrate", arm, samples, "--base-only", "--json")
    assert {change["field"].split(".")[0] for change in json.loads(out)["changes"]} == {"base"}
    new = str(tmp_path / "new.yaml")
    code, out, err = hyperbit("calibrate", arm, samples, "--fit", "modules[1].modules[3]", "--out", new)
    assert (code, err) == (0, "")
    assert "modules[1].modules[3].width" in out
    assert "modules[1].modules[1]" not in out
    before, after = (yaml.safe_load(Path(name).read_text())["modules"][0] for name in (arm, new))
    assert (after.get("type", "group"), after["count"]) == ("group", 3)
    assert [before["modules"][k]["type"] == after["modules"][k]["type"] for k in range(3)] == [True] * 3
    assert after["modules"][0]["cylinders"] == before["modules"][0]["cylinders"]
    code, _, err = hyperbit("calibrate", arm, samples, "--fit", "links")
    assert (code, "'links' has no numbers to fit; parts are base, modules[1].modules[1]" in err) == (2, True)
    code, _, err = hyperbit("calibrate", arm, samples, "--base-only", "--fit", "tip")
    assert (code, "it fits the base alone: leave --fit out" in err) == (2, True)


@pytest.mark.parametrize("files", ["trusses"], indirect=True)
def test_comments_order_and_other_numbers_of_the_file_stay(hyperbit, files, tmp_path):
    arm, samples = files
    text = "# the hall's arm\nname: a\ntolerance: {position: 0.002}  # of the drawing\n\nmodules:\n"
    text += "  - type: vgt  # trusses\n    count: 5\n    lengths: [0.20, 0.25]  # short, long\n    width: 0.2\n"
    Path(arm).write_text(text)
    new = tmp_path / "new.yaml"
    assert hyperbit("calibrate", arm, samples, "--out", str(new))[0] == 0
    written = new.read_text()
    kept = re.sub(r"(lengths: \[)[^,]+, [^]]+|(width: ).*", r"\1\2N", written.partition("\n")[2])
    base = re.search(r"^base: .*$\n?", kept, re.MULTILINE)
    assert kept.replace(base[0], "") == re.sub(r"(lengths: \[)[^,]+, [^]]+|(width: ).*", r"\1\2N", text)


def test_the_next_configurations_are_printed(hyperbit, files, tmp_path):
    arm, samples = files
    code, out, _ = hyperbit("calibrate", arm, str(tmp_path / "none.csv"), "--propose", "3")
    manipulator, rows = load(Path(arm)).manipulator, out.splitlines()
    assert (code, len({tuple(parse_configuration(manipulator, row)) for row in rows})) == (0, 3)
    assert hyperbit("calibrate", arm, samples, "--propose", "3")[1].splitlines() != rows


@pytest.fixture
def tracker(endpoint):
    """Publishes the tip of an arm that is not as in its file, as a tracker does."""
    real, states = erring(load(ARM), np.random.default_rng(0), size=0.002), queue.SimpleQueue()

    def publish(client):
        while (state := states.get()) is not None:
            if state["configuration"] is not None:
                seen = real.computed(np.array([[int(c) for c in state["configuration"]]]), oriented=False)
                place = seen.tips[0, :2, 3].tolist()
                stale = {"position": [0.0, 0.0], "stamp": state["stamp"] - 0.9}
                for sent in (stale, {"position": ["a", 1]}, {"position": place, "stamp": state["stamp"]}):
                    client.put("measured_tip", json.dumps(sent).encode())

    with connected("planar16", endpoint, None) as client, client.subscribe("state", states.put):
        tracking = threading.Thread(target=publish, args=(client,))
        tracking.start()
        yield
        states.put(None)
        tracking.join()


@pytest.mark.usefixtures("tracker", "own_folders")
def test_the_arm_is_driven_and_calibrated_by_its_tracker(hyperbit, endpoint, tmp_path):
    samples, new = tmp_path / "samples.csv", tmp_path / "new.yaml"
    words = "calibrate", str(ARM), str(samples), "--measure", "measured_tip", "--yes", "--connect", endpoint
    code, out, err = hyperbit(*words, "--most", "6")
    assert (code, samples.exists()) == (2, True), err
    assert samples.read_text().count("\n") == 7
    assert "6 samples, at least 10 are needed" in err
    code, out, err = hyperbit(*words, "--most", "12", "--out", str(new), "--json")
    assert (code, samples.read_text().count("\n")) == (0, 13), err
    told = json.loads(out[out.index("{") :])
    assert told["held_out"]["position"]["rms"] < 0.01 * told["before"]["position"]["rms"]
    assert new.read_text().count("#") == ARM.read_text().count("#") + 1


def test_a_source_that_is_none_is_named(hyperbit, endpoint, tmp_path):
    words = "calibrate", str(ARM), str(tmp_path / "s.csv"), "--yes", "--connect", endpoint
    code, _, err = hyperbit(*words, "--measure", "laser")
    assert (code, "prompt, measured_tip or a CSV file of tips is needed" in err) == (2, True)
    (tmp_path / "s.csv").write_text("actuators,x,y\n")
    code, _, err = hyperbit(*words, "--measure", "prompt")
    assert (code, "the columns configuration,x,y or configuration,x,y,th are needed" in err) == (2, True)


def test_a_new_file_in_another_folder_takes_tables_and_commission_along(hyperbit, tmp_path):
    arm, samples, there = tmp_path / "arm.yaml", tmp_path / "samples.csv", tmp_path / "there"
    words = ["--module", "revolute angles=-15,15 link=40", "--repeat", "4", "--wiring", "csv", "--defaults"]
    assert hyperbit("new", str(arm), *words)[0] == 0
    (tmp_path / "arm.commission.json").write_text("{}")
    rows = [f"{text},{x + 3},{y + 1}" for text, (x, y) in ((f"{k:04b}", tip_of(load(arm), k)) for k in range(16))]
    samples.write_text("configuration,x,y\n" + "\n".join(rows) + "\n")
    there.mkdir()
    (there / "arm-wiring.csv").write_text("another\n")
    command = "calibrate", str(arm), str(samples), "--base-only", "--out", str(there / "new.yaml")
    code, _, err = hyperbit(*command)
    assert (code, "differs from" in err) == (2, True), err
    (there / "arm-wiring.csv").unlink()
    code, _, err = hyperbit(*command)
    assert code == 0, err
    assert hyperbit("check", str(there / "new.yaml"))[0] == 0
    assert sorted(it.name for it in there.iterdir()) == ["arm-wiring.csv", "new.commission.json", "new.yaml"]


def tip_of(arm, k):
    return arm.manipulator.tip([int(bit) for bit in f"{k:04b}"])[:2, 3]
