"""A second daemon of the same arm does not serve it; warnings on clock, network and ledger."""

import logging
import os
import threading
from collections.abc import Iterator
from contextlib import ExitStack

import pytest
import zenoh

from hyperbit.controller.gateway.claim import AlreadyRunning, Claim
from hyperbit.controller.gateway.daemon import CERTIFICATES_EVERY, REMEMBERED, Warnings
from hyperbit.controller.network import session
from hyperbit.controller.program import Fault
from tests.gateway.conftest import ARM, Gateway
from tests.waiting import PATIENCE, eventually


def drives_here() -> str:
    return f"another daemon drives the arm 'a': process {os.getpid()} on "


def confirmed(claim: Claim, timeout: float = PATIENCE) -> bool:
    try:
        claim.confirm(timeout)
    except AlreadyRunning:
        return False
    return True


@pytest.fixture
def two(endpoint: str) -> Iterator[list[zenoh.Session]]:
    with ExitStack() as stack:
        yield [
            stack.enter_context(zenoh.open(session.configuration("peer", **{how: endpoint})))
            for how in ("listen", "connect")
        ]


def test_of_two_that_start_together_the_one_with_the_lower_id_serves(two: list[zenoh.Session]) -> None:
    claims, serving = [Claim(it, ARM) for it in two], dict[str, bool]()

    def confirm(it: zenoh.Session, claim: Claim) -> None:
        serving[str(it.zid())] = confirmed(claim)

    threads = [threading.Thread(target=confirm, args=both) for both in zip(two, claims, strict=True)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    lower, higher = sorted(str(it.zid()) for it in two)
    assert serving == {lower: True, higher: False}


@pytest.mark.parametrize("first", [0, 1])
def test_who_has_confirmed_its_claim_keeps_the_arm(two: list[zenoh.Session], first: int) -> None:
    Claim(two[first], ARM).confirm()
    with pytest.raises(AlreadyRunning, match=drives_here()):
        Claim(two[1 - first], ARM).confirm()


def test_a_claim_that_was_given_up_bars_nobody(two: list[zenoh.Session]) -> None:
    for it in two:
        claim = Claim(it, ARM)
        claim.confirm()
        claim.close()


def test_a_daemon_of_another_name_may_start(two: list[zenoh.Session]) -> None:
    for it, name in zip(two, ("a", "b"), strict=True):
        Claim(it, name).confirm()


def test_a_daemon_of_an_earlier_version_bars_others_by_its_token(gateway: Gateway) -> None:
    with pytest.raises(AlreadyRunning, match=drives_here()):
        Claim(gateway.other(), ARM).confirm()


def test_a_peer_that_connects_hears_of_the_first_one_though_a_moment_later(gateway: Gateway) -> None:
    with zenoh.open(session.configuration("peer", connect=gateway.endpoint)) as peer, pytest.raises(AlreadyRunning):
        Claim(peer, ARM).confirm()


def test_through_a_router_the_token_of_a_killed_daemon_is_waited_for(endpoint: str) -> None:
    with ExitStack() as stack:
        stack.enter_context(zenoh.open(session.configuration("router", listen=endpoint)))
        first, second = (
            stack.enter_context(zenoh.open(session.configuration("client", connect=endpoint))) for _ in range(2)
        )
        key = f"hyperbit/{ARM}/@claim/0"  # lower than each id, and nobody answers on it
        token = first.liveliness().declare_token(key)
        eventually(lambda: any(reply.ok for reply in second.liveliness().get(key, timeout=1.0)))
        claim = Claim(second, ARM)
        with pytest.raises(AlreadyRunning, match="does not say where"):
            claim.confirm(timeout=0.5)
        timer = threading.Timer(0.3, token.undeclare)
        timer.start()
        claim.confirm(timeout=PATIENCE)
        timer.join()


class Bench:
    def __init__(self) -> None:
        self.now, self.set_by, self.reachable = 100.0, 1.7e9, True
        self.others: tuple[Fault, ...] = ()
        self.certificates = list[str]()
        self.warnings = Warnings(
            lambda: self.reachable,
            lambda: self.others,
            lambda: self.now + self.set_by,
            lambda: self.now,
            lambda: self.certificates,
        )

    def codes(self, after: float = 0.05) -> list[str]:
        self.now += after
        return [fault.code for fault in self.warnings.active()]


@pytest.fixture
def bench() -> Bench:
    return Bench()


def test_nothing_is_wrong_at_first(bench: Bench) -> None:
    assert bench.codes() == []


@pytest.mark.parametrize("by", [-3600.0, 2.0])
def test_a_clock_that_was_set_is_a_warning_for_a_while(
    bench: Bench, by: float, caplog: pytest.LogCaptureFixture
) -> None:
    bench.set_by += by
    assert bench.codes() == ["clock-set"]
    assert f"set by {by:+.1f} s" in bench.warnings.active()[0].message
    assert bench.codes(REMEMBERED - 1) == ["clock-set"]
    assert bench.codes(2) == []
    assert [record.levelno for record in caplog.records] == [logging.WARNING]
    bench.set_by += by
    assert bench.codes() == ["clock-set"]
    assert len(caplog.records) == 2


def test_a_slewed_clock_is_none(bench: Bench) -> None:
    for _ in range(100):
        bench.set_by += 0.4
        assert bench.codes() == []


def test_a_lost_network_is_a_warning_until_a_while_after_its_return(bench: Bench) -> None:
    bench.reachable = False
    for _ in range(21):
        assert bench.codes(1) == ["network-lost"]
    assert "for 20.0 s" in bench.warnings.active()[0].message
    bench.reachable = True
    assert bench.codes(REMEMBERED - 1) == ["network-lost"]
    assert bench.codes(2) == []


def test_warnings_of_others_are_added(bench: Bench) -> None:
    bench.others = (Fault("ledger-unwritten", "ledger", "full"),)
    assert bench.codes() == ["ledger-unwritten"]


def test_a_certificate_that_ends_soon_is_a_warning_until_it_is_renewed(bench: Bench) -> None:
    assert bench.codes() == []
    bench.certificates = ["certificate a.pem ends on 2026-06-10"]
    assert bench.codes(CERTIFICATES_EVERY) == ["certificate-ends"]
    assert bench.codes(CERTIFICATES_EVERY / 2) == ["certificate-ends"]
    bench.certificates = []
    assert bench.codes(CERTIFICATES_EVERY) == []
