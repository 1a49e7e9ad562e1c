"""When garbage is collected."""

import gc
import weakref
from collections.abc import Iterator

import pytest

from hyperbit.controller.executor.process.run import TOO_MANY, WORTH, Garbage


class Cycle:
    def __init__(self) -> None:
        self.own = self


@pytest.fixture
def garbage() -> Iterator[Garbage]:
    with Garbage() as garbage:
        yield garbage


def left(count: int) -> list[weakref.ref[Cycle]]:
    return [weakref.ref(Cycle()) for _ in range(count)]


def gone(references: list[weakref.ref[Cycle]]) -> bool:
    return all(reference() is None for reference in references)


def test_nothing_is_collected_by_itself(garbage: Garbage) -> None:
    assert not gc.isenabled()
    assert gc.get_freeze_count() > 1000
    assert not gone(left(2 * TOO_MANY))


def test_a_holding_arm_collects_all(garbage: Garbage) -> None:
    references = left(WORTH + 1)
    garbage.collect(holding=False)
    assert not gone(references)
    garbage.collect(holding=True)
    assert gone(references)


def test_a_busy_loop_collects_the_youngest_if_they_are_too_many(garbage: Garbage) -> None:
    cycles = [Cycle() for _ in range(TOO_MANY)]
    references = left(TOO_MANY)
    garbage.collect(holding=False)
    assert gone(references)
    older = [weakref.ref(cycle) for cycle in cycles]
    del cycles
    garbage.collect(holding=False)
    assert not gone(older[:-1])
    garbage.collect(holding=True)
    assert gone(older[:-1])


def test_garbage_collection_is_restored_at_the_end() -> None:
    with Garbage():
        pass
    assert gc.isenabled()
    assert gc.get_freeze_count() == 0
