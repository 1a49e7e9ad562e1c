"""Clients repeat a request without an answer, and the goal still runs once."""

import threading
import time
from collections.abc import Iterator
from typing import Any

import pytest
import zenoh

from hyperbit.controller.messages.goals import Feedback, Result
from hyperbit.controller.motion.decoding.goal import GoalMessage
from hyperbit.controller.network.client import TRIES, Client, Unanswered, answer_timeout
from hyperbit.controller.planning.core.events import Identity, PublishResult
from tests.gateway.conftest import ARM, Gateway
from tests.waiting import PATIENCE, eventually


class Deaf:
    """A session whose first gets bring no reply, as with stale routes; the daemon may have received them."""

    def __init__(self, session: Any, deaf: int) -> None:
        self._session, self.deaf, self.gets = session, deaf, 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._session, name)

    def get(self, *words: Any, **options: Any) -> Iterator[Any]:
        self.gets += 1
        replies = self._session.get(*words, **options)
        return iter([]) if self.gets <= self.deaf and list(replies) is not None else replies


@pytest.mark.parametrize("deaf", [0, 1, TRIES - 2])
def test_a_request_without_reply_is_asked_again(gateway: Gateway, deaf: int) -> None:
    session = Deaf(gateway.other(), deaf)
    assert Client(session, ARM).request("stop", timeout=PATIENCE)["accepted"]
    assert session.gets == deaf + 1


def test_a_request_that_only_a_stranger_has_answered_is_asked_again(gateway: Gateway) -> None:
    """The daemon may not be reached yet, when a stranger answers."""
    heard = list[zenoh.Query]()

    def answer(query: zenoh.Query) -> None:
        heard.append(query)
        with query:
            query.reply("hyperbit/b/stop", b"{}" if len(heard) == 1 else b'{"accepted": true, "message": ""}')

    queryable = gateway.other().declare_queryable("hyperbit/b/stop", answer)
    assert Client(gateway.other(), "b").request("stop", timeout=PATIENCE)["accepted"]
    assert len(heard) == 2
    queryable.undeclare()  # type: ignore[no-untyped-call]


def test_the_last_try_is_in_a_new_session(gateway: Gateway) -> None:
    session, opened = Deaf(gateway.other(), 1000), []
    client = Client(session, ARM, lambda: opened.append(gateway.other()) or opened[-1])
    assert client.request("stop", timeout=PATIENCE)["accepted"]
    assert (session.gets, len(opened)) == (TRIES - 1, 1)
    assert client.request("cancel", timeout=PATIENCE)["accepted"]
    assert len(opened) == 1
    client.close()
    assert opened[0].is_closed()


def test_tries_are_bounded(gateway: Gateway) -> None:
    session = Deaf(gateway.other(), 1000)
    with pytest.raises(Unanswered, match="did not accept this stop"):
        Client(session, ARM).request("stop", timeout=PATIENCE)
    assert session.gets == TRIES


def test_a_name_that_nobody_serves_is_said_to_be_so(gateway: Gateway) -> None:
    with pytest.raises(Unanswered, match="no daemon for arm 'b'"):
        Client(gateway.other(), "b").request("stop", timeout=PATIENCE)


def test_a_request_that_takes_too_long_is_not_asked_again(gateway: Gateway) -> None:
    gateway.planner.holding.set()
    with pytest.raises(Unanswered):
        gateway.client().request("plan", {"waypoints": []}, timeout=0.5)
    assert gateway.planner.keys() == ["plan"]


@pytest.mark.parametrize("deaf", [0, 1, 1000])
def test_a_goal_that_is_asked_again_runs_once_and_is_heard_to_its_end(gateway: Gateway, deaf: int) -> None:
    client = Client(Deaf(gateway.other(), deaf), ARM, gateway.other)
    gateway.planner.holding.set()
    told: list[Any] = []

    def plan() -> None:
        reply, answer = eventually(lambda: gateway.planner.waiting)[0]
        reply(answer)
        eventually(lambda: told)
        gateway.outbox.publish("feedback", Feedback(id=answer.id, waypoint=0))
        for number, goal in enumerate(("another", answer.id)):
            result = Result(id=goal, status="succeeded")
            gateway.outbox.publish_result(PublishResult(number, Identity(1, number), False, result))

    planner = threading.Thread(target=plan)
    planner.start()
    result = client.run({"waypoints": []}, told.append, silence=PATIENCE)
    planner.join()
    client.close()
    assert result["status"] == "succeeded"
    assert [message.get("waypoint") for message in told] == [None, 0]
    assert gateway.planner.keys() == ["goal"]
    (_, goal) = gateway.planner.heard[0]
    assert isinstance(goal, GoalMessage)
    assert goal.id == result["id"] == told[0]["id"]


def test_a_goal_without_a_word_is_given_up(gateway: Gateway) -> None:
    with pytest.raises(Unanswered, match="no message on goal x"):
        gateway.client().run({"id": "x", "waypoints": []}, silence=0.2)


def test_a_refused_goal_is_answered_at_once(gateway: Gateway) -> None:
    assert gateway.client().run({"id": "far", "waypoints": []})["reason"] == "out-of-reach"


def test_messages_are_heard(gateway: Gateway) -> None:
    heard: list[Any] = []
    gateway.client().subscribe("feedback", heard.append)

    def published() -> bool:
        gateway.outbox.publish("feedback", {"n": 1})
        time.sleep(0.01)
        return bool(heard)

    eventually(published)
    assert heard[0] == {"n": 1}


@pytest.mark.parametrize(
    ("payload", "timeout"),
    [
        ({}, 10.0),
        ({"deadline": 50.0}, 60.0),
        ({"begin_within": 30.0}, 32.0),
        ({"begin_within": 1.0, "deadline": 50.0}, 3.0),
        ({"begin_within": "a", "deadline": None}, 10.0),
    ],
)
def test_a_client_waits_until_the_arm_can_no_longer_begin(payload: dict[str, Any], timeout: float) -> None:
    assert answer_timeout(payload) == timeout
