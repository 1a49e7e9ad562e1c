"""Warnings on clock, network and ledger, with simulated clocks."""

import logging

import pytest

from hyperbit.controller.gateway.daemon import CERTIFICATES_EVERY, REMEMBERED, Warnings
from hyperbit.controller.program import Fault


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
