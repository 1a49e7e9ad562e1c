"""Workers that are lost; the last file of its folder, because a worker takes long to start again."""

from __future__ import annotations

import os
import signal

import pytest

import hyperbit as hb
from hyperbit.controller.studies.shares import StudyFailed
from hyperbit.controller.studies.stream import results
from tests.studies.conftest import answers
from tests.studies.test_cluster import Squares


def test_solutions_are_those_of_one_process_though_a_worker_is_killed(client, ik, goals):
    alone = answers(hb.map(ik, goals, effort=10))
    found, victim = list[hb.Solution](), client.run(os.getpid).popitem()[1]
    for solution in hb.map(ik, goals, client=client, effort=10):
        if len(found) == 20:
            os.kill(victim, signal.SIGKILL)
        found.append(solution)
    assert answers(iter(found)) == alone
    assert answers(iter(ik.solve_many(goals, effort=10))) == alone
    assert any(certificate == "optimal" for _, _, _, certificate, _, _ in alone)


def test_a_share_that_ends_each_worker_ends_the_study(two, monkeypatch):
    monkeypatch.setattr(two.cluster.scheduler, "allowed_failures", 0)
    with pytest.raises(StudyFailed, match="1 workers were lost with the same share, the last tcp"):
        list(results(Squares(), [[1], [-1], [2]], two))
