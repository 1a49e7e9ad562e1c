import pytest

from tests.executor.rig import Rig, ready


@pytest.fixture
def rig() -> Rig:
    return ready()
