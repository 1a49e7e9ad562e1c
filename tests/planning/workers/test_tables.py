"""Solvers for locked states."""

import pytest

from hyperbit.controller.planning.core.tasks import BuildTables
from hyperbit.controller.planning.workers.computations import build_tables
from hyperbit.controller.search.solver import Solver
from tests.planning.workers.conftest import Bench


def test_densities_of_the_file_serve_while_nothing_else_is_locked(bench: Bench) -> None:
    solvers: list[Solver] = list(bench.tables.solvers.values())
    assert all(solver.densities is bench.densities for solver in solvers)
    assert len({id(solver) for solver in solvers}) == 3
    assert bench.tables.locked == bytes([255] * 12)


def test_locked_actuators_reduce_the_arm(bench: Bench) -> None:
    locked = bytes([1] + [255] * 11)
    tables = build_tables(bench.arm, bench.densities, bench.weights, BuildTables(3, locked))
    assert (tables.generation, tables.locked) == (3, locked)
    assert tables.solvers["goals"].manipulator.states[0] == 4
    assert tables.solvers["goals"].densities is not bench.densities


def test_weights_count(bench: Bench) -> None:
    weights = bench.weights * 2
    tables = build_tables(bench.arm, bench.densities, weights, BuildTables(1, bench.tables.locked))
    assert tables.solvers["queries"].least_weight == pytest.approx(2.0)
