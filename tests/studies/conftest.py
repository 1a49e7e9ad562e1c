"""Two worker processes for all tests of this folder, because processes take long to start."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from distributed import Client

from hyperbit.controller.studies.workers import local_workers
from tests.commands.conftest import hyperbit, own_folders  # noqa: F401
from tests.waiting import PATIENCE


@pytest.fixture(scope="session")
def two() -> Iterator[Client]:
    with local_workers(2) as client:
        yield client


@pytest.fixture
def client(two: Client) -> Client:
    """Two workers; some tests end one, which is then started again."""
    two.wait_for_workers(2, timeout=PATIENCE)
    return two
