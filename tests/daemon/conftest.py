"""A control loop on boards in memory, while it starts and when it is ready."""

import pytest

from tests.daemon.rig import Rig


@pytest.fixture
def starting() -> Rig:
    return Rig()


@pytest.fixture
def rig(starting: Rig) -> Rig:
    starting.go()
    assert starting.loop.mode == "ready"
    return starting
