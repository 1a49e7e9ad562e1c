"""The commands send, watch, run and demo with a daemon in its own process and simulated boards."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from hyperbit.controller.commands.connection import connected
from hyperbit.controller.commands.operate import demo
from hyperbit.controller.commands.use.send import cancel_goal, counted

ARM = Path(__file__).parents[3] / "deploy" / "planar16.yaml"


def test_send_follows_a_goal_to_its_result(hyperbit, endpoint):
    code, out, err = hyperbit("send", str(ARM), "--to", "0.55,2.9", "--connect", endpoint)
    assert (code, err) == (0, "")
    assert "reached (0.5" in out


def test_send_takes_an_angle_and_reports_its_error(hyperbit, endpoint):
    code, out, err = hyperbit("send", "planar16", "--to", "0.55,2.9,0.3", "--connect", endpoint, "--json")
    *_, result = [json.loads(line) for line in out.splitlines()]
    assert (code, err) == (0, "")
    assert result["orientation"] == pytest.approx(0.3, abs=0.05)
    assert result["orientation_error"] == pytest.approx(abs(result["orientation"] - 0.3))
    code, _, err = hyperbit("send", "planar16", "--to", "0.55,2.9,1,0,0,0,1", "--connect", endpoint)
    assert code == 1
    assert "waypoints[0].position: 3 coordinates, this arm's positions have 2" in err


def test_send_of_a_file_prints_json_lines_with_the_result_last(hyperbit, endpoint, tmp_path):
    file = tmp_path / "goal.yaml"
    file.write_text("id: two\nwaypoints:\n- {position: [0.5, 2.8]}\n- {position: [0.4, 2.8], t: 0.2}\n")
    code, out, _ = hyperbit("send", "planar16", str(file), "--connect", endpoint, "--json")
    answer, *feedback, result = [json.loads(line) for line in out.splitlines()]
    assert code == 0
    assert (answer["id"], answer["accepted"]) == ("two", True)
    assert [message["waypoint"] for message in feedback] == [0, 1]
    assert (result["id"], result["status"], result["code"]) == ("two", "succeeded", 0)
    assert result["position"] == pytest.approx([0.4, 2.8], abs=0.002)


def test_send_takes_waypoints_in_a_csv_file(hyperbit, endpoint, tmp_path):
    file = tmp_path / "goal.csv"
    file.write_text("x,y,t\n0.5,2.8,\n0.4,2.8,0.2\n")
    code, out, _ = hyperbit("send", "planar16", str(file), "--connect", endpoint, "--json")
    answer, *_, result = [json.loads(line) for line in out.splitlines()]
    assert (code, answer["accepted"], result["status"]) == (0, True, "succeeded")
    assert result["position"] == pytest.approx([0.4, 2.8], abs=0.002)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("x,y,t\n0.5,2.8,soon\n", "line 2: t [s]: a number is needed, got 'soon'"),
        ("x,y\n0.5,far\n", "line 2: a number is needed, got 'far'"),
        ("x,y\n0,3,2,8\n", "line 2: 2 fields are needed, got 4; a number has a decimal point"),
        ('x,y\n"0,3",2.8\n', "line 2: a number is needed, got '0,3'; write a decimal point: 0.3"),
        ("x,y,th\n0.5,2.8,-50\n", "got '-50'; in radians, -50 degrees are -0.8727"),
        ("x,y,previous\n0.5,2.8,0\n", "columns x,y are needed, th and t are optional"),
    ],
)
def test_a_wrong_csv_file_of_a_goal_is_unusable_input(hyperbit, tmp_path, text, sentence):
    file = tmp_path / "goal.csv"
    file.write_text(text)
    code, out, err = hyperbit("send", "planar16", str(file))
    assert (code, out) == (2, "")
    assert sentence in err


def test_a_number_of_coordinates_that_no_arm_has_is_unusable_input(hyperbit):
    code, out, err = hyperbit("send", "planar16", "--to", "0.4,1,0,0")
    form = "X,Y[,TH] is needed, or in space X,Y,Z[,QX,QY,QZ,QW]: 2, 3 or 7 numbers"
    assert (code, out, err) == (2, "", f"--to: '0.4,1,0,0' is no goal; {form}\n")


@pytest.mark.parametrize(("switches", "words"), [(0, "0 switches"), (1, "1 switch"), (2, "2 switches")])
def test_switches_are_counted_in_words(switches, words):
    assert counted(switches) == words


def test_waypoints_without_times_are_refused_with_what_to_do(hyperbit, endpoint, tmp_path):
    file = tmp_path / "goal.csv"
    file.write_text("x,y\n0.5,2.8\n0.4,2.8\n")
    code, out, err = hyperbit("send", "planar16", str(file), "--connect", endpoint)
    assert (code, out) == (1, "")
    assert err.endswith("\nNext: give each waypoint a time `t` in seconds, later than the one before\n")


def test_send_follows_lines_within_a_path_tolerance(hyperbit, endpoint, tmp_path):
    file = tmp_path / "goal.yaml"
    file.write_text("id: line\nwaypoints:\n- {position: [0.5, 2.8]}\n- {position: [0.4, 2.8], t: 1.0}\n")
    words = ("send", "planar16", str(file), "--connect", endpoint)
    code, out, err = hyperbit(*words, "--path-tolerance", "0.05")
    assert (code, err) == (0, "")
    assert "waypoint 2 of 2" in out
    code, _, err = hyperbit(*words, "--path-tolerance", "0.001")
    assert code == 1
    assert "waypoints[0] to waypoints[1]: 1 s for a line of 0.1 within path_tolerance 0.001" in err


def test_send_takes_a_deadline_of_planning(hyperbit, endpoint):
    words = ("send", "planar16", "--to", "0.5,2.8", "--connect", endpoint)
    code, out, err = hyperbit(*words, "--deadline", "20")
    assert (code, err) == (0, "")
    assert "reached" in out
    code, _, err = hyperbit(*words, "--deadline", "61")
    assert code == 1
    assert "deadline: Expected `float` <= 60.0" in err


def test_a_refused_goal_fails_with_code_and_sentence(hyperbit, endpoint):
    code, out, err = hyperbit("send", "planar16", "--to", "9,9", "--connect", endpoint)
    assert (code, out) == (1, "")
    assert "code -5" in err
    assert "out of reach" in err


def test_a_goal_that_cannot_be_written_in_json_is_unusable_input(hyperbit, endpoint, tmp_path):
    file = tmp_path / "goal.yaml"
    file.write_text('{id: "\\ud800", waypoints: [{position: [0.5, 2.8]}]}')
    code, out, err = hyperbit("send", "planar16", str(file), "--connect", endpoint)
    assert (code, out) == (2, "")
    assert "no goal: " in err
    assert "surrogates not allowed" in err


def test_watch_streams_states_until_interrupted(endpoint):
    command = [sys.executable, "-m", "hyperbit", "watch", "planar16", "--connect", endpoint, "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, env=os.environ, text=True) as watching:
        assert watching.stdout is not None
        states = [json.loads(watching.stdout.readline()) for _ in range(3)]
        watching.send_signal(signal.SIGINT)
        assert watching.wait(20) == 0
    assert {state["mode"] for state in states} == {"ready"}
    assert len(states[0]["measured"]) == 48


def test_an_interrupt_cancels_the_goal_that_was_sent(endpoint, tmp_path):
    file = tmp_path / "goal.yaml"
    points = [f"- {{position: [0.5, 2.8], t: {t}}}" for t in (0, 300)]
    file.write_text("\n".join(["id: long", "waypoints:", *points]))
    words = ["send", "planar16", str(file), "--connect", endpoint]
    with subprocess.Popen(
        [sys.executable, "-m", "hyperbit", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONUNBUFFERED": "1"},
        text=True,
    ) as sending:
        assert sending.stdout is not None
        assert sending.stdout.readline()  # the daemon's answer: the goal is accepted
        sending.send_signal(signal.SIGINT)
        out, err = sending.communicate(timeout=60)
    assert (sending.returncode, err) == (130, "interrupted: canceling goal long\n")
    assert out.endswith("goal long: canceled\n")
    with connected("planar16", endpoint, None) as client:
        demo.wait_until_ready(client)


def test_an_interrupt_cancels_no_goal_of_others(capsys):
    class Answering:
        def request(self, key, payload):
            self.asked = (key, payload)
            return {"accepted": False, "message": "goal long has ended"}

    client = Answering()
    cancel_goal(client, "long", False)
    assert client.asked == ("cancel", {"id": "long"})
    assert capsys.readouterr().out == "goal long: goal long has ended\n"


def test_a_second_daemon_at_the_same_endpoint_fails_with_a_message(hyperbit, endpoint, tmp_path):
    book = str(tmp_path / "ledger.sqlite")
    code, _, err = hyperbit("run", str(ARM), "--simulate", "--listen", endpoint, "--ledger", book)
    assert code == 1
    assert endpoint in err


def test_the_demo_runs_and_draws(hyperbit, tmp_path, monkeypatch):
    """Takes seconds: a daemon starts in a process of its own, and the arm follows a curve in real time."""
    monkeypatch.setattr(demo, "CURVE_WAYPOINTS", 9)
    picture = tmp_path / "demo.png"
    code, out, err = hyperbit("demo", "--picture", str(picture))
    assert (code, err) == (0, "")
    assert f"closed curve, {demo.CURVE_WAYPOINTS} waypoints" in out
    assert picture.read_bytes().startswith(b"\x89PNG")
