"""Queries on `result`: a client that was away asks how its goal ended."""

from contextlib import ExitStack

from hyperbit.controller.network.client import Client
from tests.gateway.conftest import Gateway

ROW = {"ended": 1.9e9, "status": "aborted", "code": -4, "message": "stuck", "switches": 7}


def asked(client: Client, goal: object) -> tuple[object, object, object]:
    """Whether a query was accepted, its reason, and the result that it brought."""
    answer = client.request("result", {"id": goal})
    return answer["accepted"], answer.get("reason"), answer.get("result")


def test_a_goal_has_a_result_none_yet_or_is_unknown(endpoint: str) -> None:
    with ExitStack() as stack:
        gateway = Gateway(stack, endpoint)
        gateway.rows |= {"old": ROW, "new": {**ROW, "ended": None, "status": None}}
        client = gateway.client()
        result = {"id": "old", "status": "aborted", "code": -4, "message": "stuck", "switches": 7}
        assert asked(client, "old") == (True, None, result)
        assert asked(client, "new") == (True, None, None)
        assert asked(client, "other") == (False, "unknown-goal", None)
        gateway.readable = False
        assert asked(client, "old") == (False, "ledger-unreadable", None)


def test_malformed_queries_are_refused(endpoint: str) -> None:
    with ExitStack() as stack:
        gateway = Gateway(stack, endpoint)
        for goal in ("", 5, "x" * 200):
            assert gateway.client().request("result", {"id": goal})["accepted"] is False
        assert gateway.client().request("result")["accepted"] is False
