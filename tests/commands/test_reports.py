"""Commands that report: exit codes, JSON, and messages on stderr."""

from __future__ import annotations

import json
import os
import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from hyperbit.controller.arm.arm import load
from hyperbit.controller.commands.configure.check import wrong_rates
from hyperbit.controller.commands.operate import wear
from hyperbit.controller.planning.core.events import AcceptanceEntry, Identity, Record, ResultEntry
from hyperbit.controller.planning.ledger import Ledger
from hyperbit.controller.planning.ledger_file import SCHEMA
from hyperbit.drivers.simulation.dictionary import EDS
from tests.arm_files import document
from tests.commands.conftest import ARM

pytestmark = pytest.mark.usefixtures("own_folders")


@pytest.fixture
def changed(tmp_path: Path) -> Callable[..., Path]:
    """Writes the file of an arm in `deploy` with changes."""

    def write(change: Callable[[dict[str, Any]], object], name: str = "planar16") -> Path:
        document = yaml.safe_load((ARM.parent / f"{name}.yaml").read_text())
        change(document)
        (tmp_path / "arm.yaml").write_text(yaml.safe_dump(document, sort_keys=False))
        return tmp_path / "arm.yaml"

    return write


def test_map_fills_the_cache_once(hyperbit, tmp_path, spatial, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    code, out, _ = hyperbit("map", spatial, "--json")
    assert (code, json.loads(out)["levels"]) == (0, 7)
    [kept] = (tmp_path / "cache" / "hyperbit").iterdir()
    before = kept.stat().st_mtime_ns
    hyperbit("map", spatial)
    assert kept.stat().st_mtime_ns == before
    hyperbit("map", spatial, "--rebuild")
    assert kept.stat().st_mtime_ns > before


@pytest.mark.parametrize(
    ("name", "states"), [("revolute24", "0101"), ("platform8", "0,9,18,27"), ("motor12", "0,1,2,3")]
)
def test_every_arm_is_checked_mapped_and_planned(hyperbit, changed, name, states):
    def shorten(document):
        document["workspace"] = {"memory": 4}
        document["modules"] = [document["modules"][0] | {"count": 4}]
        document["actuators"] = [entry for entry in document["actuators"] if entry["module"] <= 4]

    file = str(changed(shorten, name))
    checked = json.loads(hyperbit("check", file, "--json")[1])
    assert (checked["ok"], checked["faults"], checked["boards"]) == (True, [], [])
    assert ["never commissioned" in warning for warning in checked["warnings"]] == [True]
    assert checked["arm"]["actuators"] == checked["arm"]["log2_configurations"]
    assert json.loads(hyperbit("map", file, "--json")[1])["megabytes"] <= 4.2
    goal = json.loads(hyperbit("fk", file, states, "--json")[1])["position"]
    assert len(goal) == (2 if name == "revolute24" else 3)
    code, out, _ = hyperbit("plan", file, "--goal", ",".join(map(str, goal)), "--json")
    found = json.loads(out)
    assert (code, found["within_tolerance"]) == (0, True)
    assert json.loads(hyperbit("fk", file, found["configuration"], "--json")[1])["position"] == found["position"]


def test_check_names_every_fault_and_opens_nothing(hyperbit, changed, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))

    def break_it(document):
        document["speed"], document["actuators"][3]["node"] = 3, 400

    file = changed(break_it)
    code, out, err = hyperbit("check", str(file))
    assert (code, out) == (2, "")
    assert [line.split(": ")[1] for line in err.splitlines()] == ["speed", "actuators[4].node"]
    code, out, _ = hyperbit("check", str(file), "--json")
    told, lines = json.loads(out), file.read_text().splitlines()
    assert (code, told["ok"], len(told["faults"])) == (2, False, 2)
    assert ["speed" in lines[n - 1] or "400" in lines[n - 1] for n in told["lines"]] == [True, True]
    for words in (("run",), ("simulate",), ("map",), ("plan", "--goal", "1,2")):
        assert hyperbit(words[0], str(file), *words[1:])[0] == 2
    assert not (tmp_path / "cache").exists()
    assert not (tmp_path / "state").exists()


def test_check_of_a_good_file(hyperbit):
    code, out, _ = hyperbit("check", str(ARM), "--json")
    told = json.loads(out)
    arm, warnings = told.pop("arm"), told.pop("warnings")
    assert (code, told) == (0, {"ok": True, "faults": [], "boards": []})
    assert ["48 of 48 actuators were never commissioned" in warning for warning in warnings] == [True]
    assert 2.5 < arm.pop("reach") < arm["length"]
    assert arm == {
        "name": "planar16",
        "dimension": 2,
        "modules": {"vgt": 16},
        "actuators": 48,
        "log2_configurations": 48,
        "boards": {"can0": 16},
        "two_outputs": [],
        "pulsed": [],
        "interlocks": [],
        "unit": "m",
        "length": pytest.approx(4.0),
        "travel_time": pytest.approx(0.05),
    }


def test_check_names_actuators_with_two_outputs_and_interlocks(hyperbit, changed):
    def extend(document):
        for k, entry in enumerate(document["actuators"][:8]):
            entry.update({"output_off": 8 + entry["output"]}, **({"pulse": 0.02} if k == 1 else {}))
        document["interlocks"] = {"gate": {"bus": "can0", "node": 1, "input": 15}}

    code, out, err = hyperbit("check", str(changed(extend)))
    lines = [" ".join(line.split()) for line in out.splitlines()]
    named = "two outputs 1.left, 1.diagonal, 1.right, 2.left, 2.diagonal, 2.right and 2 more"
    assert (code, err, {named, "pulsed 1.diagonal", "interlocks gate"} <= {*lines}) == (0, "", True), out


def test_check_warns_of_what_is_probably_a_mistake(hyperbit, tmp_path):
    file = tmp_path / "arm.yaml"
    file.write_text(ARM.read_text().replace("bitrate: 1000000", "bitrate: 123456"))
    line = next(k for k, text in enumerate(file.read_text().splitlines(), 1) if "bitrate: 123456" in text)
    code, out, _ = hyperbit("check", str(file))
    assert (code, f"Warning: {file}, line {line}: buses[1].bitrate: 123456 bit/s is unusual" in out) == (0, True), out
    told = json.loads(hyperbit("check", str(file), "--json")[1])
    assert (told["ok"], len(told["warnings"])) == (True, 2)


def test_a_missing_bus_fails_with_a_message(hyperbit, changed):
    file = str(changed(lambda document: document["buses"][0].update(channel="no-such-bus")))
    for words in (("simulate", file), ("check", file, "--bus")):
        code, _, err = hyperbit(*words)
        assert (code, "no-such-bus" in err or "bus cannot be opened" in err) == (1, True)


@pytest.mark.parametrize("info", [{"bittiming": {"bitrate": 250_000}}, {"bittiming_bitrate": 250_000}])
def test_a_bus_with_another_bit_rate_than_the_files_is_told(monkeypatch, info):
    link = [{"linkinfo": {"info_data": info}}]  # drivers without bit timings, as of slcan, tell the rate alone
    done = subprocess.CompletedProcess((), 0, json.dumps(link).encode())
    monkeypatch.setattr(subprocess, "run", lambda *_, **__: done)
    [(bus, text)] = wrong_rates(load(ARM))
    where = "/etc/systemd/network/80-can0.network"
    told = f"can0 has 250000 bit/s, the arm's file 1000000: change {where} or the file"
    assert (bus.name, text) == ("can0", told)
    for nothing in (b"", b"[]", b"[{}]"):
        done.stdout = nothing
        assert not list(wrong_rates(load(ARM)))


def test_wear_reads_the_ledger(hyperbit, tmp_path):
    path = tmp_path / "ledger.sqlite"
    assert hyperbit("wear", str(ARM), "--ledger", str(path))[0] == 1
    with sqlite3.connect(path) as other:
        other.execute("CREATE TABLE something (x)")
    assert hyperbit("wear", str(ARM), "--ledger", str(path))[0] == 1
    path.unlink()
    ledger = Ledger(path, ["1.left", "1.diagonal"])
    result = ResultEntry(1.9e9, "succeeded", 0, "reached", 5)
    ledger.record(Record(1, Identity(1, 1), AcceptanceEntry("a", 1.8e9, 2), result))
    ledger.close()
    code, out, _ = hyperbit("wear", str(ARM), "--ledger", str(path), "--json")
    assert code == 0
    assert json.loads(out)["switches"]["1.left"] == 0
    assert json.loads(out)["goals"][0]["status"] == "succeeded"
    assert "1 succeeded" in hyperbit("wear", str(ARM), "--ledger", str(path))[1]


@pytest.fixture
def ledgers(monkeypatch, tmp_path):
    monkeypatch.setattr(wear, "INSTANCES", tmp_path / "arms")
    return (
        tmp_path / "state" / "hyperbit" / "planar16.sqlite",
        tmp_path / "arms" / "arm" / "planner" / "planar16.sqlite",
    )


def test_wear_reads_the_ledger_that_was_written_last(hyperbit, ledgers):
    user, service = ledgers
    code, _, err = hyperbit("wear", str(ARM))
    assert (code, err.startswith(f"{user}: no ledger there")) == (1, True)
    service.parent.mkdir(parents=True)
    with sqlite3.connect(service) as book:
        book.executescript(SCHEMA)
    assert hyperbit("wear", str(ARM))[1].startswith(f"ledger {service}\n")
    user.parent.mkdir(parents=True)
    shutil.copy(service, user)
    for newest, other in ((user, service), (service, user)):
        os.utime(newest, (2e9, 2e9))
        os.utime(other, (1e9, 1e9))
        code, out, err = hyperbit("wear", str(ARM), "--json")
        assert (code, json.loads(out)["ledger"], err) == (0, str(newest), "")
    user.with_name(f"{user.name}-wal").touch()
    os.utime(user.with_name(f"{user.name}-wal"), (2.1e9, 2.1e9))
    assert json.loads(hyperbit("wear", str(ARM), "--json")[1])["ledger"] == str(user)


def test_wear_names_a_ledger_that_it_cannot_read(hyperbit, ledgers, monkeypatch):
    user, service = ledgers
    is_file = Path.is_file
    service.parent.mkdir(parents=True)

    def refused(path):
        if path == service:
            raise PermissionError(13, "Permission denied")
        return is_file(path)

    monkeypatch.setattr(Path, "is_file", refused)
    code, _, err = hyperbit("wear", str(ARM))
    assert code == 1
    refusal, missing, _ = err.splitlines()
    assert refusal == f"{service}: Permission denied; root can read the service's ledger"
    assert missing.startswith(f"{user}: no ledger there")


def test_figure5_prints_nine_rows_and_draws(hyperbit, tmp_path):
    picture = tmp_path / "five.png"
    code, out, _ = hyperbit("figure5", "--picture", str(picture), "--json")
    rows = [json.loads(text) for text in out.splitlines()]
    assert code == 0
    assert len(rows) == 9
    assert max(row["error"] for row in rows) <= 0.003
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_missing_objects_are_reported_for_each_board(hyperbit, tmp_path):
    path = tmp_path / "other.eds"
    path.write_text(EDS.read_text().replace("[1017]", "[1FFF]"))
    code, out, _ = hyperbit("check", str(ARM), "--eds", str(path), "--json")
    told = json.loads(out)
    assert (code, told["ok"], len(told["boards"])) == (1, False, 16)
    assert told["boards"][0]["lacks"][0]["object"] == "1017h sub 0"


def test_what_the_eds_does_not_tell_is_no_fault(hyperbit, tmp_path):
    path = tmp_path / "coupler.eds"
    text = EDS.read_text().replace("[1017]", "[1FFF]").replace("[1001]\n", "[1001]\nObjFlags\n")
    path.write_text(f"{text}\n[M1SubExt1017]\nDataType=6\n")
    code, out, _ = hyperbit("check", str(ARM), "--eds", str(path), "--node", "can0/5")
    assert code == 0
    assert "can0/5: coupler.eds does not tell whether it fits: 1017h sub 0: the EDS says that modules bring it" in out
    assert "  EDS, line " in out
    _, out, _ = hyperbit("check", str(ARM), "--eds", str(path), "--node", "can0/5", "--json")
    assert [board["verdict"] for board in json.loads(out)["boards"]] == ["open"]


def test_process_data_that_do_not_fit_are_refused_before_the_executor_starts(hyperbit, tmp_path):
    value = document(12)
    for k, entry in enumerate(value["actuators"]):
        entry.update(node=1, output=8 * k, input=None)
    path = tmp_path / "arm.yaml"
    path.write_text(yaml.safe_dump(value))
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
    path = tmp_path / "arm.yaml"
    path.write_text(yaml.safe_dump(value))
    code, out, _ = hyperbit("check", str(path))
    assert (code, "6 actuators on 3 boards: no fault" in out.replace("\n", " ")) == (0, True), out
    code, _, err = hyperbit("simulate", str(path), "--board", "can0/8=standard")
    assert (code, "no board can0/8, there are can0/1, can0/2, can0/9" in err.replace("\n", " ")) == (2, True), err
    code, _, err = hyperbit("board", str(path), "can0/8", "errors")
    assert (code, "which has can0/1, can0/2, can0/9" in err.replace("\n", " ")) == (2, True), err
