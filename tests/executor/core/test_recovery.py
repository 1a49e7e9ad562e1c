"""Faults that clear by themselves, and defects of the executor's own code."""

import pytest

from hyperbit.controller.executor.core.events import ExecutorTick
from hyperbit.controller.executor.core.modes import CLEARING, RETRY
from hyperbit.controller.program import TICK, Reset
from hyperbit.drivers.canopen.faults import ArmFault
from tests.executor.rig import CAN, A, B, Rig


@pytest.mark.parametrize("code", sorted(CLEARING))
def test_faults_that_clear_by_themselves_are_left_without_a_reset(rig: Rig, code: str) -> None:
    rig.run(A, B)
    rig.go(0.15)
    rig.master.fail(ArmFault(code, "can0", "gone"))
    rig.go(5 * RETRY)
    assert rig.mode == "fault"
    rig.master.back = True
    rig.go(RETRY + 3 * TICK)
    assert (rig.mode, rig.snapshot.faults, rig.switched) == ("ready", (), [A])


@pytest.mark.parametrize("verb", ["tick", "commit", "ends", "receive_event"])
def test_a_defect_is_a_fault_the_arm_holds_and_the_executor_goes_on(rig: Rig, verb: str) -> None:
    rig.run(A, B)
    rig.go(0.05)
    rig.master.broken = {verb}
    rig.do(CAN)
    rig.go(0.5)
    assert (rig.results, rig.mode) == ([(1, "aborted")], "fault")
    assert "internal error" in rig.reason
    assert sum("Traceback" in text for text in rig.errors()) == 1
    rig.master.broken = set()
    rig.send(Reset(1, rig.epoch))
    rig.go(2 * TICK)
    assert rig.mode == "ready"


def test_the_awake_time_begins_with_the_first_tick_and_counts_a_late_tick_as_two() -> None:
    rig = Rig()
    rig.connect()
    assert rig.core.motion.clock == 0.0
    rig.go()
    assert rig.core.motion.clock == 0.0
    rig.go()
    assert rig.core.motion.clock == pytest.approx(TICK)
    rig.agenda.run(1.0)
    rig.do(ExecutorTick())
    assert rig.core.motion.clock == pytest.approx(3 * TICK)
