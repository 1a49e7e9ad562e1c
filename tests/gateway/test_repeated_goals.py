"""Repeated goals run once, and all get the same answer."""

import json
import threading

import pytest
from msgspec.structs import replace

from hyperbit.controller.gateway.arrivals import MOST, REMEMBERED, RepeatedGoals, Reply, keys_of
from hyperbit.controller.messages.goals import Answer, done, refused
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refusal

GOAL = b'{"id": "a", "waypoints": []}'
ANONYMOUS = b'{"waypoints": []}'


class Bench:
    """A planner that answers on demand, and clients that remember their answers."""

    def __init__(self) -> None:
        self.now = 0.0
        self.goals = RepeatedGoals(lambda: self.now)
        self.planned: list[tuple[bytes, Reply]] = []
        self.answers: list[Answer] = []

    def send(self, payload: bytes = GOAL, number: bytes = b"") -> None:
        keys = keys_of(payload, number, has_id=bool(json.loads(payload).get("id")))
        self.goals.receive_goal(keys, self.answers.append, lambda reply: self.planned.append((payload, reply)))

    def accept(self) -> None:
        payload, reply = self.planned[-1]
        reply(replace(done("accepted"), id=json.loads(payload).get("id", "made-up")))


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.mark.parametrize(("payload", "number"), [(GOAL, b""), (GOAL, b"7"), (ANONYMOUS, b"7")])
def test_a_goal_that_is_asked_again_is_planned_once_and_each_is_answered(
    bench: Bench, payload: bytes, number: bytes
) -> None:
    bench.send(payload, number)
    bench.send(payload, number)
    assert bench.answers == []
    bench.accept()
    bench.send(payload, number)
    assert len(bench.planned) == 1
    assert len(bench.answers) == 3
    assert bench.answers[0] == bench.answers[1] == bench.answers[2]


def test_a_client_that_attaches_the_same_to_each_request_has_each_goal_run(bench: Bench) -> None:
    for k in range(3):
        bench.send(b'{"id": "g%d", "waypoints": []}' % k, b"my client")
        bench.accept()
    bench.send(b'{"waypoints": []}', b"my client")
    assert len(bench.planned) == 4
    assert [answer.id for answer in bench.answers] == ["g0", "g1", "g2"]


def test_a_goal_without_id_or_number_is_always_new(bench: Bench) -> None:
    bench.send(ANONYMOUS)
    bench.send(ANONYMOUS)
    bench.send(b'{"id": null, "waypoints": []}')
    bench.send(b'{"id": null, "waypoints": []}')
    assert len(bench.planned) == 4


def test_a_goal_is_forgotten_by_the_first_answer_a_second_after_the_last_look(bench: Bench) -> None:
    for bench.now, payload, number in ((0.0, GOAL, b"7"), (REMEMBERED, ANONYMOUS, b"8"), (REMEMBERED + 1, GOAL, b"9")):
        bench.send(payload, number)
        bench.accept()
        bench.goals.ended("a")
    bench.send(GOAL, b"7")
    assert len(bench.planned) == 4


def test_another_goal_of_the_same_id_is_new(bench: Bench) -> None:
    bench.send(GOAL)
    bench.send(b'{"id": "a", "waypoints": [1]}')
    bench.send(GOAL, b"7")
    assert len(bench.planned) == 2


def test_a_goal_that_has_ended_may_be_sent_again_but_not_repeated(bench: Bench) -> None:
    bench.send(GOAL, b"7")
    bench.accept()
    bench.goals.ended("a")
    bench.send(GOAL, b"7")
    assert len(bench.planned) == 1
    bench.send(GOAL)
    bench.send(GOAL, b"8")
    assert len(bench.planned) == 2


def test_a_refused_goal_may_be_sent_again(bench: Bench) -> None:
    bench.send(GOAL, b"7")
    bench.planned[0][1](refused(Refusal(Reason.BUSY), "a"))
    bench.send(GOAL, b"7")
    assert [answer.accepted for answer in bench.answers] == [False, False]
    bench.send(GOAL, b"8")
    assert len(bench.planned) == 2


def test_old_numbers_are_forgotten_but_not_those_of_running_goals(bench: Bench) -> None:
    bench.send(ANONYMOUS, b"1")
    bench.accept()
    bench.send(GOAL, b"2")
    bench.accept()
    bench.goals.ended("a")
    bench.now = REMEMBERED + 1
    bench.send(ANONYMOUS, b"1")
    assert len(bench.planned) == 2
    bench.send(ANONYMOUS, b"3")
    bench.accept()  # with an answer, old goals are forgotten
    bench.send(ANONYMOUS, b"2")
    assert len(bench.planned) == 4


def test_memory_is_bounded(bench: Bench) -> None:
    for k in range(3 * MOST):
        bench.send(b'{"id": "%d"}' % k, b"%d" % k)
        bench.accept()
    assert len(bench.goals.known) <= MOST + 2


def test_a_goal_that_could_not_be_requested_may_be_sent_again(bench: Bench) -> None:
    with pytest.raises(ZeroDivisionError):
        bench.goals.receive_goal(keys_of(GOAL, b"7", has_id=True), bench.answers.append, lambda reply: 1 / 0)
    bench.send(GOAL, b"7")
    assert len(bench.planned) == 1


def test_goals_that_come_in_many_threads_are_planned_once_and_each_is_answered(bench: Bench) -> None:
    barrier = threading.Barrier(9)

    def send(number: int) -> None:
        barrier.wait()
        for k in range(100):
            bench.send(b'{"id": "%d"}' % k, b"%d-%d" % (k, number % 2))

    threads = [threading.Thread(target=send, args=(number,)) for number in range(8)]
    for thread in threads:
        thread.start()
    barrier.wait()
    answered = 0
    while any(thread.is_alive() for thread in threads) or answered < len(bench.planned):
        for payload, reply in bench.planned[answered:]:
            answered += 1
            reply(replace(done("accepted"), id=json.loads(payload)["id"]))
    assert len(bench.planned) == 100
    assert len(bench.answers) == 800
