"""Sessions of the wire on a router."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest

from hyperbit.controller.ros2.wire.session import Session
from tests.network.played import Router


@pytest.fixture
def router(stack: ExitStack) -> Router:
    return Router(stack)


@pytest.fixture
def connect(router: Router) -> Iterator[Callable[[], Session]]:
    with ExitStack() as closing:
        yield lambda: closing.enter_context(Session(router.endpoint, timeout=60.0))
