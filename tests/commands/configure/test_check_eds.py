"""The option --eds of the command check."""

from __future__ import annotations

import json

import pytest

from hyperbit.drivers.simulation.dictionary import EDS
from tests.commands.conftest import ARM


def test_boards_that_lack_nothing(hyperbit):
    code, out, err = hyperbit("check", str(ARM), "--eds", str(EDS), "--node", "can0/5")
    assert (code, err) == (0, "")
    assert "\n  can0/5: has all needed objects, according to board.eds\n" in out
    assert "can0/6" not in out


def test_missing_objects_are_reported_for_each_board(hyperbit, tmp_path):
    path = tmp_path / "other.eds"
    path.write_text(EDS.read_text().replace("[1017]", "[1FFF]"))
    code, out, _ = hyperbit("check", str(ARM), "--eds", str(path), "--json")
    told = json.loads(out)
    assert (code, told["ok"], len(told["boards"])) == (1, False, 16)
    assert told["boards"][0]["lacks"][0]["object"] == "1017h sub 0"


def test_faults_name_the_wrong_option(hyperbit, tmp_path):
    code, _, err = hyperbit("check", str(ARM), "--node", "can0/5")
    assert (code, "--node needs --eds FILE" in err) == (2, True)
    code, _, err = hyperbit("check", str(ARM), "--eds", str(EDS), "--node", "can7/5")
    assert (code, "can7/5: the arm has no such board, only can0/1, can0/2" in err) == (2, True)
    code, _, err = hyperbit("check", str(ARM), "--eds", str(tmp_path / "none.eds"))
    assert (code, "none.eds" in err, "No such file" in err) == (2, True, True)


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


@pytest.mark.parametrize("option", [["--eds", str(EDS)], ["--bus"]])
def test_an_arm_without_boards_has_nothing_to_compare(hyperbit, tmp_path, option):
    path = tmp_path / "arm.yaml"
    path.write_text("name: a\nmodules: [{type: revolute, count: 2, angles: [-0.3, 0.3]}]\ntolerance: {position: 1}\n")
    code, _, err = hyperbit("check", str(path), *option)
    assert (code, "has no boards, which --bus and --eds need" in err) == (2, True)
