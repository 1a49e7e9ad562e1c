"""What a running daemon is told to do without: actuators that are stuck."""

from __future__ import annotations

import json

import pytest


def test_degrade_holds_actuators_and_uses_them_again(hyperbit, endpoint):
    words = ("degrade", "planar16", "--connect", endpoint)
    assert hyperbit(*words, "5.left=contracted", "7.right=contracted") == (
        0,
        "held: 5.left (contracted)\nheld: 5.left (contracted), 7.right (contracted)\n",
        "",
    )
    code, out, err = hyperbit(*words, "5.left=free", "7.right=free", "--json")
    assert (code, err) == (0, "")
    assert [json.loads(line)["message"] for line in out.splitlines()] == [
        "held: 7.right (contracted)",
        "no actuator held",
    ]


def test_a_refused_change_ends_with_1_and_those_before_it_stand(hyperbit, endpoint):
    words = ("degrade", "planar16", "--connect", endpoint)
    code, out, err = hyperbit(*words, "5.left=contracted", "5.middle=contracted", "7.right=contracted")
    assert (code, out) == (1, "held: 5.left (contracted)\n")
    assert err == "refused (code -1): actuator: '5.middle' is none of this arm's, which are 1.left to 16.right\n"
    code, out, err = hyperbit(*words, "7.right=extended", "--json")
    assert (code, json.loads(out)["accepted"]) == (1, False)
    assert err == "refused (code -1): state: the end-stop of 7.right reads contracted\n"
    assert hyperbit(*words, "5.left=free")[1] == "no actuator held\n"


@pytest.mark.parametrize("change", ["5.left", "5.left=", "5.left=1", "5.left=up", "5.left contracted", "5.\udcff=free"])
def test_what_is_no_change_is_unusable_input(hyperbit, change):
    code, out, err = hyperbit("degrade", "planar16", "5.left=free", change)
    assert (code, out) == (2, "")
    assert "an actuator, =, and one of contracted, extended, free are needed, as in 5.left=contracted" in err


def test_degrade_wants_a_change(hyperbit):
    assert hyperbit("degrade", "planar16")[0] == 2


def test_a_daemon_that_is_not_there_fails_in_words(hyperbit):
    code, _, err = hyperbit("degrade", "planar16", "5.left=free", "--connect", "tcp/127.0.0.1:1")
    assert code == 1
    assert "no daemon at tcp/127.0.0.1:1" in err
