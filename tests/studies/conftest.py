"""Two worker processes for all tests of this folder, because processes take long to start."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from distributed import Client

import hyperbit as hb
from hyperbit.controller.studies.workers import local_workers
from tests.commands.conftest import hyperbit, own_folders  # noqa: F401
from tests.waiting import PATIENCE

ARM = str(Path(__file__).parents[2] / "deploy" / "planar16.yaml")


@pytest.fixture(scope="session")
def two() -> Iterator[Client]:
    with local_workers(2) as client:
        for handler in logging.getLogger("distributed").handlers:  # Dask has silenced pytest's own
            handler.setLevel(logging.NOTSET)
        yield client


@pytest.fixture
def client(two: Client) -> Client:
    """Two workers; a worker that was lost is started again."""
    two.wait_for_workers(2, timeout=PATIENCE)
    return two


@pytest.fixture(scope="session")
def ik() -> hb.Solver:
    return hb.Solver(hb.load(ARM))


@pytest.fixture(scope="session")
def goals(ik) -> list[Any]:
    return [ik.arm.position(configuration) for configuration in ik.arm.sample(150, seed=4)]


def answers(found: Iterator[hb.Solution]) -> list[tuple[Any, ...]]:
    return [(s.configuration.tolist(), s.cost, s.bound, s.certificate, s.effort, s.error) for s in found]
