"""Commands that report: exit codes, JSON, and messages on stderr."""

from __future__ import annotations

import json
import os
import shutil
import sqlite3
from pathlib import Path

import pytest
import yaml

from hyperbit.controller.commands.operate import wear
from hyperbit.controller.planning.core.events import AcceptanceEntry, Identity, Record, ResultEntry
from hyperbit.controller.planning.ledger import Ledger
from hyperbit.controller.planning.ledger_file import SCHEMA

ARM = str(Path(__file__).parents[2] / "deploy" / "planar16.yaml")

pytestmark = pytest.mark.usefixtures("own_folders")


def test_fk_prints_position_and_orientation_exactly_so(hyperbit):
    code, out, _ = hyperbit("fk", ARM, "4646676700771206", "--json")
    found = json.loads(out)
    assert code == 0
    assert list(found) == ["position", "orientation"]
    assert found["position"] == pytest.approx([3.0, 0.7], abs=1e-3)
    assert found["orientation"] == pytest.approx(-1.621, abs=1e-3)


def test_fk_of_a_spatial_arm_gives_a_quaternion(hyperbit, spatial):
    code, out, _ = hyperbit("fk", spatial, "000000", "--json")
    assert code == 0
    assert json.loads(out)["position"] == pytest.approx([0, 0, 0.6])
    assert json.loads(out)["orientation"] == pytest.approx([0, 0, 0, 1])


@pytest.mark.parametrize("states", ["46", "4646676700771208", "464667670077120x", ""])
def test_a_wrong_configuration_is_unusable_input(hyperbit, states):
    code, out, err = hyperbit("fk", ARM, states)
    assert code == 2
    assert out == ""
    assert "CONFIGURATION" in err


def test_map_fills_the_cache_once(hyperbit, tmp_path, spatial):
    code, out, _ = hyperbit("map", spatial, "--json")
    assert code == 0
    assert json.loads(out)["levels"] == 7
    [kept] = (tmp_path / "cache" / "hyperbit").iterdir()
    before = kept.stat().st_mtime_ns
    hyperbit("map", spatial)
    assert kept.stat().st_mtime_ns == before
    hyperbit("map", spatial, "--rebuild")
    assert kept.stat().st_mtime_ns > before


@pytest.mark.parametrize("name", ["revolute24", "platform8", "motor12"])
def test_every_arm_is_checked_mapped_and_planned(hyperbit, name, tmp_path):
    arm = yaml.safe_load((Path(ARM).parent / f"{name}.yaml").read_text())
    arm["workspace"] = {"memory": 4}  # coarser and faster
    file = tmp_path / f"{name}.yaml"
    file.write_text(yaml.safe_dump(arm))
    checked = json.loads(hyperbit("check", str(file), "--json")[1])
    assert (checked["ok"], checked["faults"], checked["warnings"], checked["boards"]) == (True, [], [], [])
    assert checked["arm"]["actuators"] == checked["arm"]["log2_configurations"]
    assert json.loads(hyperbit("map", str(file), "--json")[1])["megabytes"] <= 4.2
    joints = sum(group["count"] for group in arm["modules"])
    states = [{"revolute24": k % 2, "platform8": 9 * k, "motor12": k}[name] for k in range(joints)]
    written = ("" if name == "revolute24" else ",").join(map(str, states))
    code, out, _ = hyperbit("fk", str(file), written, "--json")
    goal = json.loads(out)["position"]
    assert (code, len(goal)) == (0, 2 if name == "revolute24" else 3)
    code, out, _ = hyperbit("plan", str(file), "--goal", ",".join(map(str, goal)), "--json")
    found = json.loads(out)
    assert (code, found["within_tolerance"]) == (0, True)
    assert json.loads(hyperbit("fk", str(file), found["configuration"], "--json")[1])["position"] == found["position"]


def test_check_names_every_fault_and_opens_nothing(hyperbit, tmp_path):
    file = tmp_path / "arm.yaml"
    arm = yaml.safe_load(Path(ARM).read_text())
    arm["speed"], arm["actuators"][3]["node"] = 3, 400
    file.write_text(yaml.safe_dump(arm))
    code, out, err = hyperbit("check", str(file))
    assert (code, out) == (2, "")
    assert [line.split(": ")[1] for line in err.splitlines()] == ["speed", "actuators[4].node"]
    code, out, _ = hyperbit("check", str(file), "--json")
    assert code == 2
    assert json.loads(out)["ok"] is False
    assert len(json.loads(out)["faults"]) == len(json.loads(out)["lines"]) == 2
    lines = file.read_text().splitlines()
    assert ["speed" in lines[n - 1] or "400" in lines[n - 1] for n in json.loads(out)["lines"]] == [True, True]
    for command in (
        ("run", str(file)),
        ("simulate", str(file)),
        ("map", str(file)),
        ("plan", str(file), "--goal", "1,2"),
    ):
        assert hyperbit(*command)[0] == 2
    assert not (tmp_path / "cache").exists()
    assert not (tmp_path / "state").exists()


def test_check_of_a_good_file(hyperbit):
    code, out, _ = hyperbit("check", ARM)
    assert code == 0
    lines = [line.split() for line in out.splitlines()[1:]]
    assert [words[0] for words in lines[:5]] == ["modules", "actuators", "configurations", "boards", "length"]
    assert [words[1] for words in lines[:5]] == ["16", "48", "2^48", "16", "4"]
    code, out, _ = hyperbit("check", ARM, "--json")
    assert code == 0
    told = json.loads(out)
    assert 2.5 < told["arm"].pop("reach") < told["arm"]["length"]
    assert told == {
        "ok": True,
        "faults": [],
        "warnings": [],
        "boards": [],
        "arm": {
            "name": "planar16",
            "dimension": 2,
            "modules": {"vgt": 16},
            "actuators": 48,
            "log2_configurations": 48,
            "boards": {"can0": 16},
            "two_outputs": [],
            "pulsed": [],
            "interlocks": [],
            "length": pytest.approx(4.0),
            "travel_time": pytest.approx(0.05),
        },
    }


def test_check_names_actuators_with_two_outputs_and_interlocks(hyperbit, tmp_path):
    arm = yaml.safe_load(Path(ARM).read_text())
    for k, entry in enumerate(arm["actuators"][:8]):
        entry.update({"output_off": 8 + entry["output"]}, **({"pulse": 0.02} if k == 1 else {}))
    arm["interlocks"] = {"gate": {"bus": "can0", "node": 1, "input": 15}}
    file = tmp_path / "arm.yaml"
    file.write_text(yaml.safe_dump(arm))
    code, out, err = hyperbit("check", str(file))
    assert (code, err) == (0, "")
    lines = [line.split(maxsplit=1) for line in out.splitlines()]
    named = "outputs     1.left, 1.diagonal, 1.right, 2.left, 2.diagonal, 2.right and 2 more"
    assert ["two", named] in lines
    assert ["pulsed", "1.diagonal"] in lines
    assert ["interlocks", "gate"] in lines


def test_check_draws_the_arm(hyperbit, tmp_path, spatial):
    for arm in (ARM, spatial):
        picture = tmp_path / "arm.png"
        assert hyperbit("check", arm, "--picture", str(picture))[0] == 0
        assert picture.read_bytes().startswith(b"\x89PNG")
        picture.unlink()
    code, _, err = hyperbit("check", ARM, "--picture", str(tmp_path / "arm.xyz"))
    assert (code, "arm.xyz: cannot be written: " in err) == (2, True)


def test_check_warns_of_what_is_probably_a_mistake(hyperbit, tmp_path):
    file = tmp_path / "arm.yaml"
    file.write_text(Path(ARM).read_text().replace("bitrate: 1000000", "bitrate: 123456"))
    code, out, _ = hyperbit("check", str(file))
    line = (
        file.read_text().splitlines().index("  - {name: can0, interface: socketcan, channel: can0, bitrate: 123456}")
        + 1
    )
    assert (code, f"Warning: {file}, line {line}: buses[1].bitrate: 123456 bit/s is unusual" in out) == (0, True), out
    told = json.loads(hyperbit("check", str(file), "--json")[1])
    assert (told["ok"], len(told["warnings"])) == (True, 1)


def test_an_arm_without_boards_is_not_run(hyperbit, spatial):
    for command in ("run", "simulate", "demo"):
        code, _, err = hyperbit(command, spatial)
        assert code == 2
        assert "actuators" in err


def test_a_missing_bus_fails_with_a_message(hyperbit, tmp_path):
    arm = yaml.safe_load(Path(ARM).read_text())
    arm["buses"][0]["channel"] = "no-such-bus"
    file = tmp_path / "arm.yaml"
    file.write_text(yaml.safe_dump(arm))
    for command in (("simulate", str(file)), ("check", str(file), "--bus")):
        code, _, err = hyperbit(*command)
        assert code == 1
        assert "no-such-bus" in err or "bus cannot be opened" in err


def test_a_missing_daemon_fails_with_a_message(hyperbit):
    for command in (("send", "planar16", "--to", "1,2"), ("watch", "planar16")):
        code, _, err = hyperbit(*command, "--connect", "tcp/127.0.0.1:1")
        assert code == 1
        assert "nobody listens at tcp/127.0.0.1:1" in err


@pytest.mark.parametrize("words", [(), ("--to", "a"), ("no-such-goal.yaml",), ("goal.yaml", "--to", "1,2")])
def test_unusable_arguments_of_send_end_with_2(hyperbit, words):
    code, out, err = hyperbit("send", "planar16", *words)
    assert (code, out) == (2, "")
    assert err


def test_wear_reads_the_ledger(hyperbit, tmp_path):
    path = tmp_path / "ledger.sqlite"
    assert hyperbit("wear", ARM, "--ledger", str(path))[0] == 1
    with sqlite3.connect(path) as other:
        other.execute("CREATE TABLE something (x)")
    assert hyperbit("wear", ARM, "--ledger", str(path))[0] == 1
    path.unlink()
    ledger = Ledger(path, ["1.left", "1.diagonal"])
    result = ResultEntry(1.9e9, "succeeded", 0, "reached", 5)
    ledger.record(Record(1, Identity(1, 1), AcceptanceEntry("a", 1.8e9, 2), result))
    ledger.close()
    code, out, _ = hyperbit("wear", ARM, "--ledger", str(path), "--json")
    assert code == 0
    assert json.loads(out)["switches"]["1.left"] == 0
    assert json.loads(out)["goals"][0]["status"] == "succeeded"
    assert "1 succeeded" in hyperbit("wear", ARM, "--ledger", str(path))[1]


@pytest.fixture
def ledgers(monkeypatch, tmp_path):
    monkeypatch.setattr(wear, "INSTANCES", tmp_path / "arms")
    return (
        tmp_path / "state" / "hyperbit" / "planar16.sqlite",
        tmp_path / "arms" / "arm" / "planner" / "planar16.sqlite",
    )


def test_wear_reads_the_ledger_that_was_written_last(hyperbit, ledgers):
    user, service = ledgers
    code, _, err = hyperbit("wear", ARM)
    assert (code, err.startswith(f"{user}: no ledger there")) == (1, True)
    service.parent.mkdir(parents=True)
    with sqlite3.connect(service) as book:
        book.executescript(SCHEMA)
    assert hyperbit("wear", ARM)[1].startswith(f"ledger {service}\n")
    user.parent.mkdir(parents=True)
    shutil.copy(service, user)
    for newest, other in ((user, service), (service, user)):
        os.utime(newest, (2e9, 2e9))
        os.utime(other, (1e9, 1e9))
        code, out, err = hyperbit("wear", ARM, "--json")
        assert (code, json.loads(out)["ledger"], err) == (0, str(newest), "")
    user.with_name(f"{user.name}-wal").touch()
    os.utime(user.with_name(f"{user.name}-wal"), (2.1e9, 2.1e9))
    assert json.loads(hyperbit("wear", ARM, "--json")[1])["ledger"] == str(user)


def test_wear_names_a_ledger_that_it_cannot_read(hyperbit, ledgers, monkeypatch):
    user, service = ledgers
    is_file = Path.is_file
    service.parent.mkdir(parents=True)

    def refused(path):
        if path == service:
            raise PermissionError(13, "Permission denied")
        return is_file(path)

    monkeypatch.setattr(Path, "is_file", refused)
    code, _, err = hyperbit("wear", ARM)
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


def test_help_lists_all_commands(hyperbit):
    code, out, _ = hyperbit("--help")
    assert code == 0
    names = "run simulate demo send watch cancel stop reset lock obstacles plan fk map figure5 check wear calibrate"
    assert all(name in out for name in names.split())
