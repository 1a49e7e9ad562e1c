"""Descriptions of plans that are not run."""

import pytest

from hyperbit.controller.planning.core.tasks import DescribePlan
from hyperbit.controller.planning.workers.computations import Abandoned, ArmModel, describe
from hyperbit.controller.refusals.refusal import Refusal
from tests.planning.workers.conftest import A, B, Bench, abandoned, nothing


def task(bench: Bench, seconds: float = 60.0) -> DescribePlan:
    return DescribePlan(bench.task(A, B), seconds)


@pytest.fixture
def model(bench: Bench) -> ArmModel:
    return ArmModel(bench.arm, "queries")


def test_a_plan_is_described_point_by_point(bench: Bench, model: ArmModel) -> None:
    payload = describe(model, task(bench), nothing, lambda: False).payload
    assert (payload["accepted"], len(payload["waypoints"])) == (True, 2)
    assert payload["switches"] == sum(point["switches"] for point in payload["waypoints"])
    assert payload["message"] == f"2 waypoints, {payload['switches']} switches"
    labels = [label for point in payload["waypoints"] for stage in point["stages"] for label in stage]
    assert len(labels) == payload["switches"]


def test_a_description_in_haste_is_one(bench: Bench, model: ArmModel) -> None:
    assert describe(model, task(bench), nothing, lambda: True).payload["accepted"]


def test_a_query_that_takes_too_long_is_refused(bench: Bench, model: ArmModel) -> None:
    with pytest.raises(Refusal, match=r"planning took longer than -1 s"):
        describe(model, task(bench, seconds=-1.0), nothing, lambda: False)


def test_an_abandoned_query_ends(bench: Bench, model: ArmModel) -> None:
    with pytest.raises(Abandoned):
        describe(model, task(bench), abandoned, lambda: False)
