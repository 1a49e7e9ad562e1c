"""Collision checks of stages, and scenes."""

from collections.abc import Callable
from typing import Any

import pytest

from hyperbit.controller.planning.core.tasks import BuildScene, Checked, CheckStages, CheckStanding
from hyperbit.controller.planning.workers.computations import Abandoned, build_scene, check_stages, check_standing
from tests.planning.conftest import DOCUMENT, JOINT, unused_states
from tests.planning.workers.conftest import HOME, A, B, Bench, abandoned, nothing


def test_the_first_collision_of_stages_is_told(bench: Bench) -> None:
    scene = bench.scene((bench.tip(*B), 0.03))
    clear = CheckStages(scene, bench.packed(*HOME), (bench.packed(*HOME),))
    assert check_stages(clear, nothing) == Checked(None)
    touching = CheckStages(scene, bench.packed(*HOME), (bench.packed(*HOME), bench.packed(*B)))
    assert "is in disc regions[0]" in (check_stages(touching, nothing).collision or "")
    assert check_stages(touching._replace(scene=bench.free), nothing) == Checked(None)


def test_an_abandoned_check_ends(bench: Bench) -> None:
    scene = bench.scene((bench.tip(*B), 0.03))
    task = CheckStages(scene, bench.packed(*HOME), (bench.packed(*A), bench.packed(*B)))
    with pytest.raises(Abandoned):
        check_stages(task, abandoned)


def test_results_of_checks_are_remembered(bench: Bench, monkeypatch: Any) -> None:
    scene = bench.scene((bench.tip(*B), 0.03))
    task = CheckStages(scene, bench.packed(*HOME), (bench.packed(*B),))
    first = check_stages(task, nothing)
    monkeypatch.setattr("hyperbit.controller.obstacles.keep_out.sweep_of", None)
    assert check_stages(task, nothing) == first
    other = check_stages(task._replace(stages=(bench.packed(*A),)), nothing)
    assert (other.collision or "").startswith("a collision check failed")


def test_a_collision_at_rest_is_told(bench: Bench, make_bench: Callable[[dict[str, Any]], Bench]) -> None:
    scene = bench.scene((bench.tip(*B), 0.03))
    assert check_standing(CheckStanding(scene, bench.packed(*HOME))) == Checked(None)
    assert "is in disc regions[0]" in (check_standing(CheckStanding(scene, bench.packed(*B))).collision or "")
    other = make_bench({**DOCUMENT, "modules": [JOINT]})
    unknown = bytes([unused_states(other.arm)])
    assert check_standing(CheckStanding(other.scene(([0.2, 0.0], 1.0)), unknown)) == Checked(None)


def test_a_scene_counts_obstacles_of_the_file_and_those_sent(make_bench: Callable[[dict[str, Any]], Bench]) -> None:
    disc = {"disc": {"centre": [5, 5], "radius": 0.1}}
    bench = make_bench({**DOCUMENT, "obstacles": [disc]})
    sent = bench.scene(([3.0, 3.0], 0.1)).keep_out.sent
    built = build_scene(bench.arm, BuildScene(4, sent))
    assert (built.scene.generation, built.scene.free, built.total, built.sent) == (4, False, 2, 1)
    assert not bench.free.free
