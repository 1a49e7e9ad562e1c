"""Advice for faults: one for each board."""

from hyperbit.controller.executor.core.modes import CLEARING
from hyperbit.controller.panel.arms.faults import ADVICE, After, advised


def advices(*faults: tuple[str, str]) -> list[str]:
    return [fault["advice"] for fault in advised([{"code": code, "source": source} for code, source in faults])]


def test_each_source_has_one_advice() -> None:
    assert advices(("stuck", "5.left"), ("interlock", "can0/1")) == [str(ADVICE["stuck"]), str(ADVICE["interlock"])]
    first, second = advices(("stuck", "5.left"), ("unexpected-motion", "5.left"))
    assert (first, second) == (str(ADVICE["stuck"]), "")


def test_contrary_advices_become_one_that_says_what_to_mend_and_to_reset() -> None:
    for order in (("board-rebooted", "board-lost"), ("board-lost", "board-rebooted")):
        first, second = advices(*((code, "can0/3") for code in order))
        assert first == "Check the board's supply and wires. Then hold Reset."
        assert second == ""
    assert advices(("bus-off", "can0"), ("bus-busy", "can0"))[0].endswith(After.ITSELF.value)


def test_the_faults_that_end_by_themselves_are_those_of_the_executor() -> None:
    assert {code for code, advice in ADVICE.items() if advice.after is After.ITSELF} == CLEARING


def test_a_fault_that_needs_a_reset_says_so() -> None:
    faults = advised([{"code": code, "source": "can0/3"} for code in ("board-rebooted", "board-lost", "degraded")])
    assert [fault["reset"] for fault in faults] == [True, False, False]
