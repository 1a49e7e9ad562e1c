"""Keys and wildcards: which requests reach the planner, and which get an answer; strangers; queries on `result`."""

import json
import os
from typing import Any

import pytest
import zenoh
from msgspec import to_builtins

from hyperbit.controller.gateway.arrivals import Rate
from hyperbit.controller.gateway.server import MOST_REFUSALS, MOST_UNANSWERED, content
from hyperbit.controller.messages.goals import refused
from hyperbit.controller.network.client import Client
from hyperbit.controller.planning.loop import MOST_SENDERS
from tests.gateway.conftest import ARM, GOAL, NO_ACTUATOR, PREFIX, Gateway, asked
from tests.strangers import KEYS, PAYLOADS, intrude
from tests.waiting import PATIENCE, eventually

BLOCK = zenoh.CongestionControl.BLOCK
NAMED_ONLY = ("goal", "jog", "reset", "degrade", "obstacles", "fault")
EVERYWHERE = ("stop", "cancel")


@pytest.mark.parametrize("key", [*NAMED_ONLY, *EVERYWHERE, "plan"])
def test_a_query_that_names_its_key_is_carried_out(gateway: Gateway, key: str) -> None:
    (answer,) = asked(gateway.other(), f"{PREFIX}/{key}")
    assert answer["accepted"] is (key != "degrade")
    assert gateway.planner.keys() == gateway.planner.decoded == [key]


@pytest.mark.parametrize("key", [*NAMED_ONLY, *EVERYWHERE])
def test_a_put_that_names_its_key_is_carried_out_and_only_refusals_are_published(gateway: Gateway, key: str) -> None:
    results = gateway.results()
    gateway.other().put(f"{PREFIX}/{key}", GOAL)
    eventually(lambda: gateway.planner.keys() == [key])
    if key == "degrade":
        eventually(lambda: results)
    gateway.reached()
    refusal = {"id": None, "status": "refused", **to_builtins(refused(NO_ACTUATOR))}
    assert results == ([refusal] if key == "degrade" else [])


@pytest.mark.parametrize("key", NAMED_ONLY)
@pytest.mark.parametrize("expression", ["hyperbit/*/{}", f"{PREFIX}/*", "hyperbit/**", "**", "**/{}"])
def test_a_wildcard_carries_out_nothing_that_can_move_an_arm(gateway: Gateway, key: str, expression: str) -> None:
    session, results = gateway.other(), gateway.results()
    expression = expression.format(key)
    answers = [answer for answer in asked(session, expression) if "must be named" in answer.get("message", "")]
    assert any(f"{key} must be named, as in {PREFIX}/{key}; {expression} does not" in a["message"] for a in answers)
    session.put(expression, GOAL)
    eventually(lambda: any(f"{key} must be named" in result.get("message", "") for result in results))
    assert not set(gateway.planner.keys()) & set(NAMED_ONLY)


@pytest.mark.parametrize("key", EVERYWHERE)
@pytest.mark.parametrize("expression", ["hyperbit/*/{}", "hyperbit/**/{}", "**/{}"])
def test_a_wildcard_stops_and_cancels_every_arm(gateway: Gateway, key: str, expression: str) -> None:
    session = gateway.other()
    (answer,) = asked(session, expression.format(key), b"")
    assert answer["accepted"]
    session.put(expression.format(key), b"")
    eventually(lambda: gateway.planner.keys() == [key, key])


def test_a_look_around_stops_nothing(gateway: Gateway) -> None:
    answers = asked(gateway.other(), "hyperbit/**")
    assert set(gateway.planner.keys()) == {"plan"}
    assert any(answer.get("name") == ARM for answer in answers)


def test_arm_says_where_the_daemon_runs(gateway: Gateway) -> None:
    (described,) = asked(gateway.other(), f"{PREFIX}/arm", b"")
    assert described["dimension"] == 2
    assert described["daemon"]["pid"] == os.getpid()


def test_arm_has_besides_what_its_query_wants(gateway: Gateway) -> None:
    (described,) = asked(gateway.other(), f"{PREFIX}/arm", b'{"with": ["drawing"]}')
    assert "drawing" in described
    for payload in (b"no JSON", b"[]", b'{"with": 1}', b'"drawing"', b"\xff", b"[" * 100_000):
        (described,) = asked(gateway.other(), f"{PREFIX}/arm", payload)
        assert described.keys().isdisjoint({"drawing", "file", "density", "running"})
    (described,) = asked(gateway.other(), f"{PREFIX}/arm", b'{"with": ["running"]}')
    assert described["running"] is None


@pytest.mark.parametrize("key", ["setpoint", "measured_tip"])
def test_only_the_latest_sample_waits_and_wildcards_give_none(gateway: Gateway, key: str) -> None:
    session, receive = gateway.other(), gateway.planner.receive[key]
    for number in range(10):
        session.put(f"{PREFIX}/{key}", str(number))
    session.put(f"hyperbit/*/{key}", b"x")
    session.put(f"{PREFIX}/cancel", b"")  # of the same session: it arrives last
    eventually(gateway.planner.keys)
    assert [arrived.payload for arrived in receive()] == [b"9"]
    assert list(receive()) == []


@pytest.mark.parametrize("key", ["setpoint", "measured_tip"])
def test_the_latest_sample_of_each_sender_waits(gateway: Gateway, key: str) -> None:
    session, receive = gateway.other(), gateway.planner.receive[key]
    for number in range(3):
        for sender in (b"left", b"right", b"\xff"):
            session.put(f"{PREFIX}/{key}", str(number), attachment=sender)
    session.put(f"{PREFIX}/cancel", b"")
    eventually(gateway.planner.keys)
    assert [(arrived.sender, arrived.payload) for arrived in receive()] == [
        ("left", b"2"), ("right", b"2"), ("\\xff", b"2"),
    ]  # fmt: skip
    for number in range(MOST_SENDERS + 5):
        session.put(f"{PREFIX}/{key}", b"x", attachment=str(number))
    session.put(f"{PREFIX}/stop", b"")
    eventually(lambda: len(gateway.planner.keys()) == 2)
    assert [arrived.sender for arrived in receive()] == [str(k) for k in range(5, MOST_SENDERS + 5)]


def test_a_sample_that_waits_keeps_its_place_when_a_newer_one_replaces_it(gateway: Gateway) -> None:
    session, receive = gateway.other(), gateway.planner.receive["setpoint"]
    session.put(f"{PREFIX}/setpoint", "older")
    session.put(f"{PREFIX}/cancel", b"")
    session.put(f"{PREFIX}/setpoint", "newer")
    session.put(f"{PREFIX}/stop", b"")
    eventually(lambda: len(gateway.planner.keys()) == 2)
    (arrived,) = receive()
    assert arrived.payload == b"newer"
    assert arrived.arrival.number < gateway.planner.arrivals[0]


def test_requests_of_one_session_keep_their_order_over_all_keys(gateway: Gateway) -> None:
    session = gateway.other()
    sent = ["reset", "stop", "cancel", "jog", "stop", "reset"] * 30
    for key in sent:
        session.put(f"{PREFIX}/{key}", b"{}")
    eventually(lambda: len(gateway.planner.keys()) == len(sent))
    assert gateway.planner.keys() == sent
    assert gateway.planner.arrivals == sorted(gateway.planner.arrivals)


@pytest.mark.parametrize("key", ["setpoint", "measured_tip"])
def test_a_put_by_a_wildcard_displaces_no_sample(gateway: Gateway, key: str) -> None:
    session, receive = gateway.other(), gateway.planner.receive[key]
    session.put(f"{PREFIX}/{key}", "real")
    for _ in range(5):
        session.put(f"hyperbit/*/{key}", "x")
    session.put(f"{PREFIX}/cancel", b"")  # of the same session: it arrives last
    eventually(gateway.planner.keys)
    assert [arrived.payload for arrived in receive()] == [b"real"]
    assert list(receive()) == []


def test_without_a_tracker_measured_tips_are_not_declared(gateway: Gateway) -> None:
    gateway.server.close()
    gateway.planner.tracker = False
    gateway.server = gateway.serve()
    session = gateway.other()
    for key in ("measured_tip", "setpoint"):
        session.put(f"{PREFIX}/{key}", b"x")
    eventually(gateway.planner.receive["setpoint"])
    assert gateway.planner.receive["measured_tip"]() == []


def test_a_defect_is_answered_in_words_and_the_next_request_is_served(gateway: Gateway) -> None:
    session = gateway.other()
    assert asked(session, f"{PREFIX}/jog", b'"a defect"')[0]["message"] == "internal error, see the journal"
    assert asked(session, f"{PREFIX}/jog")[0]["accepted"]


def test_a_stop_overtakes_goals_that_wait(gateway: Gateway) -> None:
    client = gateway.client()
    gateway.planner.holding.set()
    session = gateway.other()
    for number in range(50):
        session.put(f"{PREFIX}/goal", f'{{"id": "{number}", "waypoints": []}}')
    eventually(lambda: len(gateway.planner.waiting) == 50)
    gateway.planner.holding.clear()
    assert client.request("stop", timeout=PATIENCE)["accepted"]


def test_malformed_goals_reach_nobody_and_a_good_one_after_a_flood_does(gateway: Gateway) -> None:
    results, session = gateway.results(), gateway.other()
    for _ in range(500):
        session.put(f"{PREFIX}/goal", b'{"waypoints": [{"position": [NaN, 1]}]}', congestion_control=BLOCK)
    session.put(f"{PREFIX}/goal", GOAL)
    eventually(gateway.planner.keys)
    assert gateway.planner.keys() == ["goal"]
    (answer,) = asked(session, f"{PREFIX}/plan", b"{")
    assert not answer["accepted"]
    assert gateway.planner.keys() == ["goal"]
    gateway.reached()
    assert results[0]["message"] == "waypoint 1, position[0]: nan is not a finite number"


def test_a_flood_of_bad_puts_is_not_published_in_full(gateway: Gateway, monkeypatch: pytest.MonkeyPatch) -> None:
    published: list[Any] = []
    monkeypatch.setattr(gateway.outbox, "publish", lambda key, payload: published.append((key, payload.status)))
    gateway.server._refusals = Rate(MOST_REFUSALS, lambda: 1e9)
    for _ in range(1000):
        gateway.server._publish_refusal(refused(NO_ACTUATOR))
    assert published == [("result", "refused")] * MOST_REFUSALS


def test_a_cancel_of_one_goal_must_name_the_arm(gateway: Gateway) -> None:
    session, goal = gateway.other(), b'{"id": "x"}'
    (answer,) = asked(session, "hyperbit/*/cancel", goal)
    assert "cancel must be named" in answer["message"]
    assert asked(session, f"{PREFIX}/cancel", goal)[0]["accepted"]
    assert asked(session, "hyperbit/*/cancel", b"[]")[0]["accepted"]
    assert [message.goal for _, message in gateway.planner.heard] == ["x", None]  # type: ignore[union-attr]


@pytest.mark.parametrize("expression", [f"{PREFIX}/cancel", "hyperbit/*/cancel"])
@pytest.mark.parametrize("payload", [b'{"id": 5}', b'{"id": "a", "id": "b"}', b'"id"', b"\xff"])
def test_a_cancel_that_cannot_be_read_cancels_all_and_says_so(
    gateway: Gateway, expression: str, payload: bytes
) -> None:
    (answer,) = asked(gateway.other(), expression, payload)
    ((key, message),) = gateway.planner.heard
    assert (answer["accepted"], key, message.goal) == (True, "cancel", None)  # type: ignore[union-attr]
    assert "everything was to be canceled, because the payload cannot be read: " in answer["message"]


def test_a_slow_planner_gets_no_more_requests_than_it_may_hold_but_each_stop(gateway: Gateway) -> None:
    session = gateway.other()
    gateway.planner.holding.set()
    for number in range(2 * MOST_UNANSWERED):
        session.put(f"{PREFIX}/jog", b"{}", congestion_control=BLOCK)
        session.put(f"{PREFIX}/stop", b"%d" % number, congestion_control=BLOCK)
    eventually(lambda: gateway.planner.keys().count("stop") == 2 * MOST_UNANSWERED)
    (answer,) = asked(session, f"{PREFIX}/jog", b"{}")
    assert "busy" in answer["message"]
    assert gateway.planner.keys().count("jog") == MOST_UNANSWERED
    for reply, answer in gateway.planner.waiting:
        reply(answer)
    gateway.planner.holding.clear()
    assert asked(session, f"{PREFIX}/jog", b"{}")[0]["accepted"]


def test_a_second_answer_is_dropped(gateway: Gateway) -> None:
    gateway.planner.holding.set()
    session, answers = gateway.other(), list[Any]()
    replies = session.get(f"{PREFIX}/reset", timeout=PATIENCE)
    (reply, answer) = eventually(lambda: gateway.planner.waiting)[0]
    reply(answer)
    reply(refused(NO_ACTUATOR))
    answers = [json.loads(content(it.ok.payload)) for it in replies if it.ok is not None]
    assert answers == [to_builtins(answer)]


def test_after_close_nobody_is_served_and_the_token_is_gone(gateway: Gateway) -> None:
    client = gateway.client()
    assert client.alive()
    gateway.server.close()
    eventually(lambda: not client.alive())
    assert asked(gateway.other(), f"{PREFIX}/stop") == []


def test_after_the_end_no_setpoint_comes(gateway: Gateway) -> None:
    gateway.server.close()
    assert [list(receive()) for receive in gateway.planner.receive.values()] == [[], []]


@pytest.mark.parametrize("key", KEYS)
def test_no_message_takes_the_stop_away(gateway: Gateway, key: str) -> None:
    stranger = gateway.other()
    intrude(stranger, f"hyperbit/{ARM}", [key])
    for payload in PAYLOADS:
        asked(stranger, f"hyperbit/{ARM}/{key}", payload)  # type: ignore[arg-type]
    client = gateway.client()
    assert client.request("stop")["accepted"]
    assert gateway.planner.keys()[-1] == "stop"
    assert client.alive()


ROW = {"ended": 1.9e9, "status": "aborted", "code": -4, "message": "stuck", "switches": 7}


def result_of(client: Client, goal: object) -> tuple[object, object, object]:
    """Whether a query was accepted, its reason, and the result that it brought."""
    answer = client.request("result", {"id": goal})
    return answer["accepted"], answer.get("reason"), answer.get("result")


def test_a_goal_has_a_result_none_yet_or_is_unknown(gateway: Gateway) -> None:
    gateway.rows |= {"old": ROW, "new": {**ROW, "ended": None, "status": None}}
    client = gateway.client()
    result = {"id": "old", "status": "aborted", "code": -4, "message": "stuck", "switches": 7}
    assert result_of(client, "old") == (True, None, result)
    assert result_of(client, "new") == (True, None, None)
    assert result_of(client, "other") == (False, "unknown-goal", None)
    gateway.readable = False
    assert result_of(client, "old") == (False, "ledger-unreadable", None)


def test_malformed_queries_are_refused(gateway: Gateway) -> None:
    for goal in ("", 5, "x" * 200):
        assert gateway.client().request("result", {"id": goal})["accepted"] is False
    assert gateway.client().request("result")["accepted"] is False
