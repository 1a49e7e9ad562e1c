"""The end of the executor: contraction of the arm, and the warning of what the boards do."""

from __future__ import annotations

import itertools
import logging

import pytest

from hyperbit.controller.host.process import Quit
from hyperbit.controller.program import TICK, Lock, Stop, unpack
from hyperbit.drivers.canopen.faults import ArmFault
from tests.executor.rig import SIZE, TRAVEL, Rig, ready

ALL = (1 << SIZE) - 1
TOLD = "when the executor has ended, the boards contract all 6 actuators (on_loss: contract)"


def warnings(rig: Rig) -> list[str]:
    return [text for level, text in rig.logged if level == logging.WARNING]


def extended(**fields: object) -> Rig:
    rig = ready(**fields)
    rig.run(*(ALL & ~(ALL << k) for k in range(1, SIZE + 1)), step=0.08)
    rig.go(2.0)
    assert rig.states == ALL
    return rig


def test_a_warning_at_start_and_end_says_that_the_boards_will_contract() -> None:
    rig = extended(on_loss="contract")
    assert warnings(rig) == [TOLD]
    rig.do(Quit())
    assert warnings(rig) == [TOLD, TOLD]
    assert rig.snapshot.reason == f"the executor is shutting down; {TOLD}"
    assert rig.core.ended
    assert rig.states == ALL


def test_there_is_no_warning_if_the_boards_hold() -> None:
    rig = extended()
    rig.do(Quit())
    assert (warnings(rig), rig.core.ended, rig.states) == ([], True, ALL)


@pytest.mark.parametrize("inrush", [None, 2])
def test_the_arm_contracts_in_stages_before_the_end(inrush: int | None) -> None:
    rig = extended(inrush=inrush, contract_on_stop=True, on_loss="contract")
    begun = len(rig.master.left)
    rig.do(Quit())
    assert (rig.mode, rig.core.ended) == ("executing", False)
    assert rig.core.ending.timeout > 3 * TRAVEL
    rig.go(1.0)
    assert rig.core.ended
    assert (rig.mode, rig.states, rig.core.motion.moving) == ("ready", 0, False)
    stages = rig.master.left[begun:]
    assert [mask.bit_count() for _, mask in stages] == ([SIZE] if inrush is None else [2, 2, 2])
    assert all(b[0] - a[0] >= TRAVEL for a, b in itertools.pairwise(stages))
    assert any(text.startswith("EXTEND_TIMEOUT_USEC=") for text in rig.notified)


def test_a_locked_actuator_is_not_contracted() -> None:
    rig = extended(contract_on_stop=True)
    rig.send(Lock(1, 3, 1))
    rig.do(Quit())
    rig.go(0.5)
    assert (rig.core.ended, rig.states) == (True, 0b001000)


def test_an_arm_that_is_stopped_does_not_contract() -> None:
    rig = extended(contract_on_stop=True)
    rig.send(Stop(1))
    rig.do(Quit())
    assert (rig.core.ended, rig.states) == (True, ALL)
    assert "the arm does not contract before the end (on_stop): it is stopped" in warnings(rig)


def test_a_fault_or_a_halt_ends_the_contraction() -> None:
    rig = extended(contract_on_stop=True, inrush=1)
    rig.do(Quit())
    rig.go(TRAVEL)
    rig.send(Stop(1))
    rig.go(0.1)
    assert rig.core.ended
    assert 0 < rig.states.bit_count() < SIZE


def test_a_contracted_arm_ends_at_once() -> None:
    rig = ready(contract_on_stop=True)
    rig.do(Quit())
    assert rig.core.ended


def test_actuators_of_unknown_state_are_contracted_too() -> None:
    rig = ready(contract_on_stop=True, channel={"output_off": True, "pulse": 0.05}, sensed=0)
    rig.do(Quit())
    rig.go(TICK)
    assert not rig.core.ended
    rig.go(0.5)
    assert (rig.core.ended, rig.switched) == (True, [ALL << SIZE])
    assert unpack(rig.snapshot.homing) == 0


@pytest.mark.parametrize("waits", ["slow_rpdos", "slow_sync"])
def test_an_arm_contracts_though_a_commit_runs_at_the_request(waits: str) -> None:
    rig = extended(contract_on_stop=True, inrush=2)
    setattr(rig.master, waits, True)
    rig.run(0b111110)
    rig.do(Quit())
    setattr(rig.master, waits, False)
    rig.go(1.0)
    assert (rig.core.ended, rig.master.outputs, rig.results[-1][1]) == (True, 0, "aborted")


@pytest.mark.parametrize("dies", [True, False])
def test_the_loss_of_the_planner_does_not_end_the_contraction(dies: bool) -> None:
    rig = extended(contract_on_stop=True, inrush=1, rest=0.5)
    rig.do(Quit())
    rig.go(TRAVEL)
    if dies:
        rig.gone()
    rig.alive = False
    rig.go(4.0)
    assert (rig.core.ended, rig.master.outputs) == (True, 0)


def test_a_fault_ends_the_contraction_in_words() -> None:
    rig = extended(contract_on_stop=True, inrush=1)
    rig.do(Quit())
    rig.go(TRAVEL)
    rig.master.fail(ArmFault("emergency", "can0/1", "short circuit"))
    rig.go(0.1)
    assert rig.core.ended
    text = "the arm is not contracted before the end (on_stop): it is fault: short circuit"
    assert warnings(rig)[-1] == text


def test_a_second_request_ends_the_contraction() -> None:
    rig = extended(contract_on_stop=True, inrush=1)
    rig.do(Quit())
    rig.go(TRAVEL)
    rig.do(Quit())
    assert "is not contracted" in warnings(rig)[-1]


def test_actuators_whose_contracting_output_goes_on_without_the_executor_are_in_the_warning() -> None:
    rig = ready(channel={"output_off": True}, sensed=0, on_loss="contract")
    assert warnings(rig) == [TOLD]


def test_the_executor_ends_after_the_travel_of_a_switch_that_has_contracted_the_arm() -> None:
    rig = extended(contract_on_stop=True)
    rig.run(0)
    rig.go(TRAVEL / 2)
    assert (rig.states, rig.core.motion.moving) == (0, True)
    rig.do(Quit())
    assert not rig.core.ended
    rig.go(TRAVEL)
    assert (rig.core.ended, rig.core.motion.moving) == (True, False)
