"""A second daemon of the same arm does not start."""

import os
import threading
from contextlib import ExitStack

import pytest
import zenoh

from controller.gateway import session
from controller.gateway.one_daemon import AlreadyRunning, require_no_other
from tests.gateway.conftest import ARM, Gateway
from tests.waiting import PATIENCE, eventually


def test_a_second_daemon_of_the_name_hears_where_the_first_one_runs(gateway: Gateway) -> None:
    with pytest.raises(AlreadyRunning, match=f"another daemon drives the arm 'a': process {os.getpid()} on "):
        require_no_other(gateway.other(), ARM, connects=True)


def test_a_daemon_of_another_name_may_start(gateway: Gateway) -> None:
    require_no_other(gateway.other(), "b", connects=True)


def test_a_peer_that_connects_hears_of_the_first_one_though_a_moment_later(gateway: Gateway) -> None:
    with (
        zenoh.open(session.configuration("peer", connect=gateway.endpoint)) as peer,
        pytest.raises(AlreadyRunning),
    ):
        require_no_other(peer, ARM, connects=True)


def test_through_a_router_two_clients_of_one_name_hear_of_each_other(endpoint: str) -> None:
    with ExitStack() as stack:
        stack.enter_context(zenoh.open(session.configuration("router", listen=endpoint)))
        first, second = (
            stack.enter_context(zenoh.open(session.configuration("client", connect=endpoint))) for _ in range(2)
        )
        require_no_other(first, ARM, connects=True)
        token = first.liveliness().declare_token(f"hyperbit/{ARM}/alive")
        eventually(lambda: any(reply.ok for reply in second.liveliness().get(f"hyperbit/{ARM}/alive", timeout=1.0)))
        with pytest.raises(AlreadyRunning, match="does not say where it runs"):
            require_no_other(second, ARM, connects=True, patience=0.5)
        timer = threading.Timer(0.3, token.undeclare)
        timer.start()
        require_no_other(second, ARM, connects=True, patience=PATIENCE)  # of a daemon that was killed a moment ago
        timer.join()
