"""Each variant boots and switches, or is refused with a sentence that names object, value and need."""

from __future__ import annotations

import pytest

from hyperbit.drivers.canopen.wire.cia301 import Command, State
from hyperbit.drivers.simulation.variants import VARIANTS
from tests.drivers.canopen.tools.test_bus_check import asked
from tests.drivers.rig import World
from tests.drivers.variants.cases import CASES, IN_VAIN, UNSEEN_WITHOUT_WRITING, Case

LONGEST = 60.0  # [s] of the boot of a board whose SDO answers take 0.6 s

all_cases = pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)


def booted(case: Case) -> World:
    return boot(case.world())


def boot(world: World) -> World:
    world.run(0.05)
    world.master.boot(world.now)
    world.until(lambda: not world.master.booting, LONGEST)
    return world


def case_of(name: str) -> Case:
    [case] = [case for case in CASES if case.name == name]
    return case


def test_each_variant_has_a_case():
    assert {case.variant for case in CASES} == set(VARIANTS)


@all_cases
def test_a_variant_boots_and_switches_or_is_refused_with_a_sentence(case):
    world = booted(case)
    faults = [fault.message for fault in world.master.boot_faults]
    assert world.master.outputs_known == (not case.refused), faults
    at_rest = world.switches()
    if case.refused:
        [sentence] = faults
        assert sentence.startswith("board can0/5 ")
        assert all(words in sentence for words in case.refused), sentence
        assert world.switches() == at_rest
        return
    warnings = [warning.message for warning in world.master.warnings()]
    assert len(warnings) == bool(case.warned), warnings  # one for a board
    assert all(words in warnings[0] for words in case.warned), warnings
    assert world.switches() == at_rest, "a boot switches nothing"
    for states in ((1, 1), (0, 1), (1, 0), (0, 0)):
        world.commit(*states)
        assert world.master.commit_failed is None
        world.run(1.0)
        assert (world.positions(), world.measured()) == (list(states), list(states))
    assert world.switches() == [4, 2]
    assert world.faults == []


@all_cases
def test_check_says_the_same(case):
    world = case.world()
    world.run(5.0)  # of late ones, the check knows no boot time
    [answer] = asked(world)
    assert (not answer.code) == (not case.refused or case.variant in UNSEEN_WITHOUT_WRITING), answer.text
    if answer.code:
        told = [words for words in case.refused if words != IN_VAIN]
        assert all(words in answer.text for words in told), answer.text
    if case.variant not in UNSEEN_WITHOUT_WRITING:
        assert all(words in answer.text for words in case.warned), answer.text


def test_a_board_that_saves_writes_is_written_only_once():
    world = booted(case_of("saves-writes"))
    objects = world.boards.board("can0/5").objects
    first = objects.flash_writes
    assert first > 0
    world.new_master()
    boot(world)
    world.commit(1, 1)
    assert objects.flash_writes == first
    world.cycle_power("can0/5")
    world.new_master()
    boot(world)
    assert world.master.outputs_known
    assert objects.flash_writes == first


def lose_master(world: World) -> None:
    world.commit(1, 1, then=1.0)
    assert world.positions() == [1.0, 1.0]
    world.stalled = True
    world.run(2.0)
    world.stalled = False
    world.new_master()


@pytest.mark.parametrize(
    ("name", "left"),
    [
        ("standard", [1, 1]),
        ("standard-contract", [0, 0]),
        ("guarding-only", [1, 1]),
        ("guarding-with-1029h", [1, 1]),
        ("guarding-with-1029h-contract", [0, 0]),
        ("one-supervision", [1, 1]),
        ("no-error-mode-hold", [1, 1]),
        ("no-error-mode-off-off", [0, 0]),
        ("no-error-mode-off-contract", [0, 0]),
        ("canopennode-device", [0, 0]),
        ("canopennode-off", [0, 0]),
        ("canopennode-contract", [0, 0]),
        ("off-in-preoperational-off", [0, 0]),
        ("off-in-preoperational-device", [0, 0]),
        ("off-in-preoperational-contract", [0, 0]),
        ("maker-object-named", [0, 0]),
        ("absent-unsupported", [1, 1]),
        ("absent-general", [1, 1]),
        ("logged-ends", [1, 1]),
        ("logged-ends-contract", [0, 0]),
        ("kept-loss", [1, 1]),
        ("kept-loss-contract", [0, 0]),
        ("kept-loss-without-history", [1, 1]),
        ("shows-error-state", [1, 1]),
        ("shows-error-state-contract", [0, 0]),
    ],
)
def test_after_the_loss_of_the_master_outputs_are_known_and_a_start_moves_nothing(name, left):
    world = booted(case_of(name))
    lose_master(world)
    assert world.positions() == left
    assert world.boards.board("can0/5").state is not State.OPERATIONAL
    before = world.switches()
    boot(world)
    assert world.master.outputs_known, world.master.boot_faults
    world.run(1.0)
    assert (world.positions(), world.switches()) == (left, before)
    assert all(pins == after for pins, after in world.boards.board("can0/5").started)
    assert world.master.outputs == sum(state << k for k, state in enumerate(left))
    world.commit(0, 1, then=1.0)
    assert world.positions() == [0, 1]


@pytest.mark.parametrize("name", ["standard", "resets-outputs"])
def test_outputs_after_a_reset_of_communication_are_read(name):
    world = booted(case_of(name))
    world.commit(1, 1, then=1.0)
    world.say(0, bytes([Command.RESET_COMMUNICATION, 5]))
    world.run(1.0)
    left = [0, 0] if name == "resets-outputs" else [1, 1]
    assert world.positions() == left
    assert not world.master.outputs_known
    before = world.switches()
    boot(world)
    world.run(1.0)
    assert (world.master.outputs_known, world.positions(), world.switches()) == (True, left, before)
    assert world.master.outputs == sum(state << k for k, state in enumerate(left))
