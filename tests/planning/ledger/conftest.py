from collections.abc import Iterator
from pathlib import Path

import pytest

from hyperbit.controller.planning.ledger import Ledger
from tests.planning.ledger.records import NAMES, SOON


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "state" / "arm.sqlite"


@pytest.fixture
def ledger(path: Path) -> Iterator[Ledger]:
    ledger = Ledger(path, NAMES, write_every=SOON)
    yield ledger
    ledger.close()
