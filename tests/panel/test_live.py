"""Open pages: shown data, allowed requests, and isolation of pages from each other."""

import asyncio
import gc
import json
import logging
import threading

import pytest
from starlette.websockets import WebSocket, WebSocketDisconnect

from hyperbit.controller.network.reach import Cause, NoSession
from hyperbit.controller.panel.arm_page import RequestThreads
from hyperbit.controller.panel.arms import arms
from tests.panel.conftest import ARM, COMMANDS, GOAL, GUARD, OPERATOR, OTHER, SOCKETS, VIEWER, Opened, Site
from tests.waiting import PATIENCE, eventually

PAGES_THAT_STOP = 24  # each asks over HTTP and over its WebSocket, again and again


def test_a_page_shows_the_arm(site: Site) -> None:
    page = site.open(VIEWER)
    arm = page.until("arm")
    assert (arm["name"], arm["dimension"], arm["lines"]) == (ARM, 2, [4] * 16)
    site.daemon.state()
    state = page.until("state")
    assert (state["mode"], state["reason"], state["error"]) == ("ready", "holding", None)
    bodies = page.until("bodies")
    assert bodies["measured"] == bodies["commanded"]
    assert len(bodies["measured"]) == 16 * 4 * 4
    assert page.until("you")["role"] == "viewer"


def test_measured_states_that_are_known_no_more_are_drawn_as_commanded(site: Site) -> None:
    page, states = site.open(), [0] * 48
    site.daemon.state(measured=[None, *states[1:]], commanded=[1, *states[1:]])
    bodies = page.until("bodies")
    assert bodies["measured"] == bodies["commanded"]
    site.daemon.state(measured=states, commanded=[1, *states[1:]])
    bodies = page.until("bodies", lambda b: b["measured"] != b["commanded"])


@pytest.mark.parametrize("path", ["/live", f"/arms/{ARM}/live"])
def test_a_page_says_why_a_connection_is_missing(site: Site, monkeypatch: pytest.MonkeyPatch, path: str) -> None:
    monkeypatch.setattr(arms, "MISSING_EVERY", 0.1)
    page, section = site.open(VIEWER, path), "arms" if path == "/live" else "presence"
    for cause in Cause:
        site.missing = [NoSession(cause, f"the cause is {cause.name}")]
        told = page.until(section, lambda it: any(cause.name in why["message"] for why in it["missing"]))  # noqa: B023
        assert told["missing"] == [{"message": f"the cause is {cause.name}", "advice": cause.value}]
    site.missing = []
    page.until(section, lambda it: not it["missing"])


def test_faults_come_with_advice(site: Site) -> None:
    page = site.open()
    fault = {"code": "stuck", "source": "5.left", "message": "5.left did not arrive"}
    site.daemon.state(mode="fault", reason="5.left did not arrive", faults=[fault])
    state = page.until("state")
    assert state["faults"][0]["message"] == fault["message"]
    assert "Reset" in state["faults"][0]["advice"]
    page.until("log", lambda log: any("5.left did not arrive" in line["text"] for line in log["lines"]))


def test_the_distance_from_the_goal_is_published(site: Site) -> None:
    page = site.open()
    told = site.daemon.state(goal="g", target={"position": [0.0, 3.0], "orientation": None})
    shift = told["tip"]["position"][1] - 3.0
    assert page.until("state")["error"] == pytest.approx((told["tip"]["position"][0] ** 2 + shift**2) ** 0.5)


def test_the_list_shows_all_arms(site: Site) -> None:
    page = site.open(VIEWER, "/live")
    site.daemon.state()
    (arm,) = page.until("arms", lambda told: told["arms"] and told["arms"][0]["mode"])["arms"]
    assert (arm["name"], arm["alive"], arm["mode"], arm["simulated"]) == (ARM, True, "ready", False)
    site.daemon.state(simulated=True)
    page.until("arms", lambda told: told["arms"][0]["simulated"])


def test_faults_of_a_simulated_arm_are_offered_and_played(site: Site) -> None:
    page = site.open()
    simulation = {"faults": [], "boards": ["can0/1"], "buses": ["can0"], "interlocks": []}
    site.daemon.told |= {"simulated": True, "simulation": simulation}  # the daemon has met its executor
    site.daemon.state(mode="starting", simulated=True)
    site.daemon.state(simulated=True)
    assert page.until("state", lambda told: told["simulated"])
    assert page.until("arm", lambda told: told["simulation"])["simulation"] == simulation
    assert page.ask("fault", fault="silence can0/1")["accepted"]
    assert site.daemon.asked == [("fault", {"fault": "silence can0/1"})]
    page.until("log", lambda told: any("anna asked for fault" in line["text"] for line in told["lines"]))


def test_a_dead_daemon_and_the_age_of_the_last_state_are_shown(site: Site) -> None:
    page = site.open()
    site.daemon.state()
    page.until("presence", lambda told: told["alive"] and told["age"] is not None)
    site.daemon.die()
    told = page.until("presence", lambda told: not told["alive"] and told["age"] > 1.0)
    assert told["age"] > 1.0


def test_a_replay_that_is_paused_is_not_old(past: Site) -> None:
    page = past.open()
    past.daemon.state()
    old = page.until("presence", lambda told: told["age"] is not None and told["age"] > 1.0)["age"]

    def fresh() -> bool:
        past.daemon.put("timeline", {"begin": 0.0, "end": 9.0, "at": 4.0, "speed": 1.0, "paused": True})
        page.heard()
        return bool(page.latest["presence"]["age"] < old)

    eventually(fresh)


def test_goals_are_planned_drawn_and_sent(site: Site) -> None:
    page = site.open()
    plan = page.ask("plan", goal=GOAL)
    assert plan["accepted"]
    assert len(plan["waypoints"][0]["body"]) == 16 * 4 * 4
    answer = page.ask("go", goal={**GOAL, "id": "mine", "stamp": 5.0})
    assert answer["accepted"]
    assert site.daemon.commands() == ["plan", "goal"]
    assert answer["id"].startswith("anna-")
    entry = page.until("goals", lambda told: told["goals"])["goals"][-1]
    assert (entry["id"], entry["status"]) == (answer["id"], "running")
    site.daemon.put("result", {"id": answer["id"], "status": "succeeded", "message": "reached", "error": 0.001})
    page.until("goals", lambda told: told["goals"][-1]["status"] == "succeeded")
    site.daemon.put("result", {"id": answer["id"], "status": "aborted", "message": "again", "repeated": True})
    site.daemon.put("result", {"id": "lost", "status": "aborted", "message": "in doubt", "repeated": True})
    told = page.until("goals", lambda told: told["goals"][-1]["id"] == "lost")["goals"]
    assert [goal["status"] for goal in told] == ["succeeded", "aborted"]
    assert [goal.get("again") for goal in told] == [True, None]
    again = page.ask("again", id=answer["id"])
    assert (again["accepted"], again["file"]) == (True, GOAL)
    assert not page.ask("again", id="lost")["accepted"]


def test_a_file_is_read_strictly(site: Site) -> None:
    page = site.open()
    answer = page.ask("file", text="waypoints:\n- position: [0.5, 2.9]\n")
    assert answer["file"] == GOAL
    assert page.ask("file", text="\ufeffx,y\n0.5,2.9\n", name="a.CSV")["file"] == GOAL
    assert page.ask("file", text="x,t\n0.5,2.8\n", name="a.csv")["message"].startswith("columns x,y are needed")
    assert site.daemon.asked == [("plan", GOAL)] * 2
    assert "alias" in page.ask("file", text="a: &x 1\nb: *x")["message"]
    assert "a mapping" in page.ask("file", text="[1]")["message"]
    assert "may have" in page.ask("file", text=" " * 60_000 + "{")["message"]


def test_a_refusal_is_shown_with_its_advice(site: Site) -> None:
    page, refused = site.open(), {"accepted": False, "code": -1, "message": "the arm is stopped: because"}
    site.daemon.answer = {**refused, "reason": "arm-stopped"}
    assert page.ask("reset")["advice"] == "leave the stop by: hold Reset"
    site.daemon.answer = {**refused, "reason": "of-a-newer-daemon"}
    assert page.ask("reset")["advice"] == ""
    site.daemon.answer = refused  # of an older daemon
    assert "advice" not in page.ask("reset")


@pytest.mark.parametrize(("do", "fields"), COMMANDS)
def test_a_viewer_commands_nothing(site: Site, do: str, fields: dict[str, object]) -> None:
    page = site.open(VIEWER)
    answer = page.ask(do, **fields)
    assert (answer["accepted"], answer["message"]) == (False, "hall may look, not command")
    assert site.daemon.asked == []


def test_a_viewer_whom_the_file_of_people_lets_stop_does_nothing_else(site: Site) -> None:
    page, headers = site.open(GUARD), site.cookie(GUARD)
    assert page.until("you")["stop"]
    assert page.ask("reset")["message"] == "dora may look and stop, not command"
    assert not page.ask("cancel")["accepted"]
    assert page.ask("stop")["accepted"]
    for path in (f"/arms/{ARM}/stop", "/stop"):
        assert site.browser.post(path, headers=headers).json()["accepted"]
    assert site.daemon.commands() == ["stop"] * 3


def test_one_page_has_control_and_anybody_may_stop(site: Site) -> None:
    first, second = site.open(OPERATOR), site.open(OTHER)
    assert first.ask("reset")["accepted"]
    assert second.until("presence", lambda told: told["control"]["name"])["control"]["name"] == "anna"
    assert second.ask("go", goal=GOAL)["message"] == "anna has control: take it first"
    assert second.ask("stop")["accepted"]
    assert second.ask("take")["accepted"]
    assert second.ask("go", goal=GOAL)["accepted"]
    assert not first.ask("jog", actuator="1.left", state="extended")["accepted"]
    second.socket.close()
    eventually(lambda: site.panel.arms.views[ARM].control.described()["name"] is None)
    assert first.ask("jog", actuator="1.left", state="extended")["accepted"]
    assert site.daemon.commands() == ["reset", "stop", "goal", "jog"]
    assert site.daemon.asked[-1][1] == {"actuators": {"1.left": "extended"}}


def test_pages_of_one_person_share_control(site: Site) -> None:
    first, second = site.open(OPERATOR), site.open(OPERATOR)
    assert first.ask("reset")["accepted"]
    assert second.ask("reset")["accepted"]
    first.socket.close()
    eventually(lambda: len(site.panel.arms.views[ARM].pages) == 1)
    assert site.panel.arms.views[ARM].control.described()["name"] == "anna", "the page that was closed had none"


def test_a_stop_waits_for_no_plan(site: Site) -> None:
    page, others = site.open(), [site.open(OTHER) for _ in range(3)]
    site.daemon.gate.clear()
    for opened in (page, *others):
        for _ in range(4):
            opened.send("plan", goal=GOAL)
    eventually(lambda: "plan" in site.daemon.commands())
    assert page.ask("stop")["accepted"]
    assert "not answered yet" in page.ask("reset")["message"]


@pytest.mark.parametrize(
    "text",
    [
        "",
        "stop",
        "[]",
        "{}",
        '{"do": "stop"}',
        '{"do": "stop", "n": -1}',
        '{"do": "stop", "n": 1, "arm": "other"}',
        '{"do": "fly", "n": 1}',
        '{"do": "jog", "n": 1, "actuator": "1.left", "state": "up"}',
        '{"do": "go", "n": 1, "goal": "there"}',
        '{"do": "go", "n": 1, "goal": {"a": ' + "[" * 50_000 + "]" * 50_000 + "}}",
        '{"do": "stop", "n": 1e400}',
        "\ud800",
    ],
)
def test_malformed_messages_are_refused_with_a_sentence(site: Site, text: str) -> None:
    page = site.open()
    page.socket.send_text(text)
    answer = page.until("reply")
    assert not answer["accepted"]
    assert answer["message"].startswith("not a request of this page: ")
    assert page.ask("stop")["accepted"]
    assert site.daemon.commands() == ["stop"]


def test_a_flood_is_refused_then_closed_and_no_other_page_notices(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hyperbit.controller.panel.arm_page.RATE", 0.0)  # however long this machine takes
    page, other = site.open(), site.open(OTHER)
    for _ in range(400):
        page.send("reset")
    assert page.closed() == 4429
    assert len(site.daemon.asked) < 100
    assert other.ask("stop")["accepted"]


def test_bytes_close_a_page_and_so_do_requests_on_the_list(site: Site) -> None:
    page, listing = site.open(), site.open(path="/live")
    page.socket.send_bytes(b"\0")
    listing.socket.send_text(json.dumps({"do": "stop", "n": 1}))
    for opened in (page, listing):
        assert opened.closed() == 4400
    assert site.daemon.asked == []


def test_names_that_are_made_up_leave_nothing(site: Site) -> None:
    page = site.open(path="/arms/nowhere/live")
    page.until("presence")
    page.socket.close()
    eventually(lambda: "nowhere" not in site.panel.arms.views)


def test_pages_that_close_in_the_middle_leave_nothing(site: Site) -> None:
    site.daemon.gate.clear()
    pages: list[Opened] = [site.open() for _ in range(5)]
    for page in pages:
        page.send("plan", goal=GOAL)
        page.socket.close()
    view = site.panel.arms.views[ARM]
    eventually(lambda: not view.pages and site.panel._places.taken == 0)
    site.daemon.gate.set()
    assert site.open().ask("stop")["accepted"]


@pytest.mark.parametrize("error", [WebSocketDisconnect(1006), RuntimeError("closed"), ValueError("a defect")])
def test_a_page_that_closes_while_it_is_sent_to_is_no_error(
    site: Site, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, error: Exception
) -> None:
    sending, ended = threading.Event(), threading.Event()

    async def fail(*_: object) -> None:
        """Fails as soon as the page has closed."""
        sending.set()
        try:
            await asyncio.Event().wait()
        except asyncio.CancelledError:
            ended.set()
            raise error from None

    monkeypatch.setattr(WebSocket, "send_text", fail)
    with site.browser.websocket_connect(f"{SOCKETS}/arms/{ARM}/live", headers=site.cookie(OPERATOR)):
        sending.wait()
    ended.wait()
    site.browser.get("/")  # on the same event loop
    gc.collect()  # asyncio tells of an exception that nobody asked for
    told = [record.getMessage() for record in caplog.records if record.levelno >= logging.ERROR]
    assert told == (["an open page failed"] if isinstance(error, ValueError) else [])


def test_stops_that_nobody_answers_hold_up_no_other_stop() -> None:
    threads, answered = RequestThreads(), threading.Event()
    try:
        for _ in range(PAGES_THAT_STOP):
            threads.stops.submit(answered.wait)
        assert threads.stops.submit(lambda: "stopped").result(PATIENCE) == "stopped"
    finally:
        answered.set()
        threads.close()
