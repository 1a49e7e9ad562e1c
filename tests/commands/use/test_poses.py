"""The command poses, and send --pose, with a daemon in its own process and simulated boards."""

from __future__ import annotations

import json


def test_a_pose_is_saved_sent_listed_and_removed(hyperbit, endpoint, tmp_path):
    connect = ("--connect", endpoint)
    code, out, err = hyperbit("send", "planar16", "--configuration", "0" * 15 + "2", *connect)
    assert (code, err) == (0, ""), out
    assert hyperbit("poses", "planar16", "--save", "tilted", *connect) == (0, "saved pose 'tilted'\n", "")
    file = tmp_path / "goal.csv"
    file.write_text("x,y,t\n0.5,2.8,0\n0.4,2.8,1\n")
    assert hyperbit("poses", "planar16", str(file), "--save", "sweep", *connect)[0] == 0
    code, out, err = hyperbit("poses", "planar16", *connect)
    assert (code, err) == (0, "")
    assert out.splitlines() == [
        f"home: configuration {'0' * 16}",
        "sweep: (0.5, 2.8), and 1 more waypoints",
        f"tilted: configuration {'0' * 15}2",
    ]
    again = ("poses", "planar16", "--save", "sweep", *connect)
    code, _, err = hyperbit(*again)
    assert (code, "planar16 has a pose 'sweep' already" in err, "--replace" in err) == (1, True, True)
    assert hyperbit(*again, "--replace")[0] == 0
    code, out, _ = hyperbit("send", "planar16", "--pose", "home", *connect, "--json")
    assert (code, json.loads(out.splitlines()[-1])["configuration"]) == (0, "0" * 16)
    code, _, err = hyperbit("send", "planar16", "--pose", "tilt", *connect)
    assert (code, "planar16 has no pose 'tilt'; it has home, sweep, tilted" in err) == (1, True)
    for name in ("tilted", "sweep"):
        assert hyperbit("poses", "planar16", "--remove", name, *connect)[0] == 0
    code, _, err = hyperbit("poses", "planar16", "--remove", "sweep", *connect)
    assert (code, "there is no saved pose 'sweep'; saved are none" in err) == (1, True)


def test_options_of_poses_that_exclude_each_other_are_unusable_input(hyperbit):
    for words in (("--save", "a", "--remove", "b"), ("goal.csv",), ("goal.csv", "--remove", "b")):
        code, _, err = hyperbit("poses", "planar16", *words)
        assert (code, "give --save NAME [FILE], or --remove NAME, or neither" in err) == (2, True)
