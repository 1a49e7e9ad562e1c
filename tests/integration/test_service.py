"""What the daemon tells, how it bears bad peers, and how it ends."""

import itertools
import json
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest
import zenoh

from controller.config import Arm
from controller.daemon import session
from controller.daemon.client import Client, Unanswered
from controller.daemon.service import Daemon, embedded, running
from drivers.simulation.simulation import Simulation
from drivers.wiring import Wiring
from tests.daemon.waiting import PATIENCE, SLOWNESS, eventually
from tests.integration.conftest import Bench
from tests.integration.harness import Observer, board_names, wired
from tests.integration.test_goals import HOUR, LEFT, MIDDLE, RIGHT


def test_the_arm_is_described(client: Observer, arm: Arm) -> None:
    described = client.ask("arm")
    assert (described["name"], described["dimension"], described["length"]) == ("planar16", 2, arm.manipulator.length)
    assert described["states"] == [8] * 16
    assert described["actuators"] == list(arm.manipulator.actuators)
    assert described["frames"][0][0] == arm.manipulator.frames[0][0].tolist()
    assert described["tolerance"] == {"position": arm.tolerance, "orientation": arm.turn}
    wiring = wired(arm, "2.diagonal")
    assert described["boards"][4] == {
        "module": 2, "actuator": "diagonal", "bus": "can0", "node": wiring.node, "output": wiring.output,
        "input": wiring.input, "weight": 1.0, "stuck": None,
    }  # fmt: skip


def test_state_comes_steadily_and_on_change(client: Observer) -> None:
    begun = len(client.heard["state"])
    eventually(lambda: len(client.heard["state"]) > begun + 40)
    stamps = [state["stamp"] for state in client.heard["state"][begun:]]
    gaps = sorted(b - a for a, b in itertools.pairwise(stamps))
    assert gaps[len(gaps) // 2] <= 0.1 * SLOWNESS, "at least ten a second, by the middle gap"
    client.move(MIDDLE, goal="a")
    client.wait_for("executing", "goal a")
    assert any(state["goal"] == "a" for state in client.heard["state"])


def test_diagnostics_tell_of_loop_bus_boards_and_queues(client: Observer, arm: Arm) -> None:
    client.move(MIDDLE)
    told = len(client.heard["diagnostics"])
    eventually(lambda: len(client.heard["diagnostics"]) > told + 1)
    it = client.heard["diagnostics"][-1]
    assert it["loop"]["ticks"] > 0
    assert it["buses"][0]["name"] == "can0"
    assert it["buses"][0]["tx_frames"] > 0
    assert 0 < it["buses"][0]["worst_case"]["load"] < 0.1, "nine tenths of 1 Mbit/s are left"
    assert [board["state"] for board in it["boards"]] == ["operational"] * len(board_names(arm))
    assert it["switches"] > 0
    assert set(it["queues"]) == {"inbox", "outbox", "planning"}
    assert it["ledger"] == "ok"
    assert it["real_time"] == "off"


def test_a_ledger_that_cannot_be_written_stops_no_arm(bench: Bench, boards: Simulation, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    bench.ledger = tmp_path / "file" / "ledger.sqlite"
    bench.run()
    client = bench.observer()
    client.wait_for("ready")
    client.move(MIDDLE)
    eventually(lambda: any("cannot be written" in it["ledger"] for it in client.heard["diagnostics"]))


def test_embedded_arms_never_share_a_bus(wiring: Wiring) -> None:
    channels = [embedded(wiring).buses[0].channel for _ in range(3)]
    assert len({*channels, wiring.buses[0].channel}) == 4


def test_the_token_tells_that_the_daemon_is_there(bench: Bench, boards: Simulation) -> None:
    client = None
    with running(bench.daemon()):
        client = bench.observer()
        eventually(lambda: client.client.alive())
    eventually(lambda: not client.client.alive())


def test_a_look_around_finds_what_tells_and_acts_on_nothing(client: Observer, bench: Bench) -> None:
    client.goal(MIDDLE, LEFT, times=[0, HOUR], id="a")
    replies = list(bench.session().get("hyperbit/**", timeout=PATIENCE))
    answers = {str(r.ok.key_expr).rpartition("/")[2]: json.loads(r.ok.payload.to_bytes()) for r in replies if r.ok}
    assert answers["arm"]["name"] == "planar16"
    for key in ("goal", "cancel", "stop", "reset", "degrade", "obstacles"):
        assert answers[key]["accepted"] is False
        assert "must be named" in answers[key]["message"]
    assert client.wait_now("executing")["goal"] == "a"
    bench.session().put("hyperbit/**", b"")
    eventually(lambda: len(client.results(None)) == 6)
    assert client.wait_now("executing")["goal"] == "a"


def test_a_stop_for_all_arms_is_taken(client: Observer, bench: Bench) -> None:
    replies = list(bench.session().get("hyperbit/*/stop", timeout=PATIENCE))
    assert [json.loads(r.ok.payload.to_bytes())["accepted"] for r in replies] == [True]
    client.wait_for("stopped")


def test_a_flood_is_refused_and_a_stop_gets_through(client: Observer, bench: Bench) -> None:
    flooding, prefix = bench.session(), "hyperbit/planar16"
    there_and_back = enumerate([LEFT, RIGHT] * int(400 / SLOWNESS))
    far = json.dumps({"waypoints": [{"t": 0.2 * k * SLOWNESS, "position": p} for k, p in there_and_back]})
    flood = [flooding.get(f"{prefix}/plan", payload=far, timeout=2 * PATIENCE) for _ in range(60)]
    assert client.ask("stop")["accepted"]
    client.wait_for("stopped")
    answers = [json.loads(reply.ok.payload.to_bytes()) for replies in flood for reply in replies]
    assert len(answers) == 60
    assert {a["accepted"] for a in answers} == {True, False}
    assert all("busy" in a["message"] for a in answers if not a["accepted"])


FROZEN = """
import sys, zenoh
from controller.daemon import session

def hear(sample):
    print("heard", flush=True)

with zenoh.open(session.configuration("client", connect=sys.argv[1])) as it:
    it.declare_subscriber(sys.argv[2], hear)
    sys.stdin.read()
"""


def test_a_frozen_reader_does_not_stall_the_arm(client: Observer, bench: Bench) -> None:
    reader = subprocess.Popen(
        [sys.executable, "-c", FROZEN, bench.endpoint, "hyperbit/**"],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    far = [{"t": 0.2 * k * SLOWNESS, "position": LEFT} for k in range(int(50 / SLOWNESS))]
    try:
        assert reader.stdout
        assert reader.stdout.readline() == "heard\n"
        reader.send_signal(signal.SIGSTOP)
        begun = len(client.heard["diagnostics"])
        for k in range(8):
            client.move((LEFT, RIGHT)[k % 2], goal=f"goal {k}")
            for _ in range(20):
                assert client.ask("plan", waypoints=far)["accepted"]
        eventually(lambda: len(client.heard["diagnostics"]) > begun + 2)
        status = [it["loop"] for it in client.heard["diagnostics"][begun:]]
        assert sum(it["ticks"] for it in status) >= 30 / SLOWNESS * len(status)
        assert max(it["longest_work"] for it in status) < 1.0 * SLOWNESS
    finally:
        reader.send_signal(signal.SIGKILL)
        reader.communicate()


def test_nobody_there_is_said_after_the_timeout(endpoint: str, bench: Bench, boards: Simulation) -> None:
    with running(bench.daemon()):
        lonely = Client(bench.session(), "other")
        with pytest.raises(Unanswered, match="no daemon for arm 'other' answered on hyperbit/other/arm within 1 s"):
            lonely.request("arm", timeout=1.0)
        assert not lonely.alive()


def test_a_goal_forgotten_by_a_daemon_that_was_started_anew_is_not_waited_for(bench: Bench, endpoint: str) -> None:
    """A stand-in that accepts, tells of other goals only, and never sends a result."""
    with zenoh.open(session.configuration("peer", listen=endpoint)) as stand_in:
        accepted = json.dumps({"accepted": True, "code": 0, "message": "accepted"})
        queryable = stand_in.declare_queryable(
            "hyperbit/a/goal", lambda q: (q.reply(str(q.key_expr), accepted), q.drop())
        )
        telling = stand_in.declare_publisher("hyperbit/a/state")
        client = Client(bench.session(), "a")
        gone = threading.Event()

        def tell() -> None:
            while not gone.wait(0.05):
                telling.put(json.dumps({"mode": "ready", "goal": None}))

        teller = threading.Thread(target=tell, daemon=True)
        teller.start()
        with pytest.raises(Unanswered, match=r"no word of goal x from arm 'a' for 0\.5 s"):
            client.run({"id": "x", "waypoints": []}, silence=0.5)
        gone.set()
        teller.join(PATIENCE)
        queryable.undeclare()


def test_what_still_waits_at_the_end_is_answered(bench: Bench, boards: Simulation) -> None:
    daemon = bench.daemon()
    daemon.quit()
    replies = bench.session().get("hyperbit/planar16/stop", timeout=PATIENCE)
    eventually(lambda: daemon.loop.inbox.waiting() == 2)
    daemon.run()
    (answer,) = [json.loads(reply.ok.payload.to_bytes()) for reply in replies]
    assert (answer["accepted"], answer["message"]) == (False, "the daemon is shutting down; the arm holds")


def test_a_daemon_that_cannot_listen_gives_its_bus_back(bench: Bench, boards: Simulation, daemon: Daemon) -> None:
    with pytest.raises(zenoh.ZError):
        bench.daemon()
    client = bench.observer()
    client.wait_for("ready")
    client.move(MIDDLE)
