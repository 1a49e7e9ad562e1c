"""`check --bus` and `run` on each variant, with each error: the same verdict, or the check says that it cannot tell.

Objects that are refused with each abort code: the board boots, or the sentence names the object.
"""

from __future__ import annotations

import functools

import pytest

from hyperbit.drivers.canopen.sdo import objects
from hyperbit.drivers.canopen.sdo.errors import MASTER_LOST
from hyperbit.drivers.simulation.objects import Objects
from hyperbit.drivers.simulation.variants import VARIANTS
from tests.drivers.rig import World
from tests.drivers.sessions import checked
from tests.drivers.variants.cases import CASES, IN_VAIN, UNSEEN_WITHOUT_WRITING, Case

HARDWARE, OVERLOAD, COMMUNICATION = (0x5000, 0x01), (0x2310, 0x03), (0x8140, 0x10)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_check_says_what_run_says(case: Case) -> None:
    world = case.world()
    world.run(5.0)  # of late ones, the check knows no boot time
    [answer] = checked(world)
    assert (not answer.code) == (not case.refused or case.variant in UNSEEN_WITHOUT_WRITING), answer.text
    if answer.code:
        assert all(words in answer.text for words in case.refused if words != IN_VAIN), answer.text
    if case.variant not in UNSEEN_WITHOUT_WRITING:
        assert all(words in answer.text for words in case.warned), answer.text


@pytest.mark.parametrize("name", VARIANTS)
def test_a_check_writes_present_values_only_so_no_lost_frame_and_no_kill_leaves_another_one(name: str) -> None:
    world = World(variant=name)
    world.run(6.0)
    written: list[str] = []
    board = world.board()
    before = {place: board.objects.value(*place) for place in places(board.objects)}
    checked(world, on_loss="contract")
    for request in world.requests():
        data = bytes.fromhex(request)
        if data[0] >> 5 == 1:
            place, size = (data[1] | data[2] << 8, data[3]), 4 - (data[0] >> 2 & 3)
            if place[0] in board.objects.described:
                written.append(request)
                assert data[4 : 4 + size] == before[place], request
    assert {place: board.objects.value(*place) for place in places(board.objects)} == before
    assert written or name != "standard"


def places(described: Objects) -> list[tuple[int, int]]:
    return [(index, sub) for index, subs in described.described.items() for sub in subs]


def lose(world: World) -> None:
    world.stalled = True
    world.run(2.0)
    world.stalled = False


def restart(world: World) -> None:
    world.new_master()
    world.boot()


# Steps before the check: errors (code and bits of 1001h) begin and end, the board loses its master, an executor starts.
HISTORIES: dict[str, list[tuple[str, tuple[int, int]] | str]] = {
    "a hardware error": [("begin", HARDWARE)],
    "a communication error": [("begin", COMMUNICATION)],
    "an error that has ended": [("begin", HARDWARE), ("end", HARDWARE)],
    "a loss": ["start", "lose"],
    "a loss, twice": ["start", "lose", "start", "lose"],
    "a hardware error, and a loss": ["start", ("begin", HARDWARE), "lose"],
    "a loss, and a hardware error": ["start", "lose", ("begin", HARDWARE)],
    "an overload, and a loss": ["start", ("begin", OVERLOAD), "lose"],
    "a communication error, and a loss": ["start", ("begin", COMMUNICATION), "lose"],
    "an error that has ended, and a loss": ["start", ("begin", HARDWARE), ("end", HARDWARE), "lose"],
    "two errors, one has ended, and a loss": [
        "start",
        ("begin", HARDWARE),
        ("begin", OVERLOAD),
        ("end", OVERLOAD),
        "lose",
    ],
    "a hardware error, and three losses": ["start", ("begin", HARDWARE), "lose", "start", "lose", "start", "lose"],
}
FIRST = {case.variant: case for case in sorted(reversed(CASES), key=lambda case: bool(case.refused), reverse=True)}
CONTRACT = [case for case in CASES if case.label == "contract" and case.variant in ("standard", "kept-loss")]


TRIED = [*FIRST.values(), *CONTRACT]
IN_FULL = (*(case.variant for case in TRIED if "error" in case.variant or "loss" in case.variant), "standard")
IN_FULL += (
    "canopennode",
    "logged-ends",
    "guarding-only",
    "guarding-with-1029h",
)  # the others have three histories each
PAIRS = [
    (case, history)
    for k, case in enumerate(TRIED)
    for i, history in enumerate(HISTORIES)
    if case.variant in IN_FULL or (i + k) % 4 == 0
]


@pytest.mark.parametrize(("case", "history"), PAIRS, ids=lambda it: getattr(it, "name", it))
def test_check_gives_the_verdict_of_run_after_errors(case: Case, history: str) -> None:
    world = case.world()
    world.run(5.0)
    for step in HISTORIES[history]:
        match step:
            case "start":
                restart(world)
            case "lose":
                lose(world)
            case "begin", error:
                world.board().emergencies.report(*error)
            case _, (code, _):
                world.board().emergencies.recover(code)
    [answer] = checked(world)
    restart(world)
    ready, told = world.master.outputs_known, [fault.message for fault in world.master.booting.faults]
    stands = any(code != MASTER_LOST for code in world.board().emergencies.present)
    assert not (ready and stands and world.objects.has(0x1003)), "an error was acknowledged"
    if "only run can tell" in answer.text:
        assert answer.code in ("", "board-stopped")
        assert "loss" in history
    elif case.variant not in UNSEEN_WITHOUT_WRITING:
        assert (not answer.code) == ready, (answer.text, told)


REFUSING = [("hold", "standard"), ("hold", "many-outputs")]
REFUSING += [("contract", "standard"), ("contract", "guarding-with-1029h")]
CODES = {  # the boot goes on after some of the first two
    "absent": sorted(objects.ABSENT),
    "read-only": [objects.READ_ONLY],
    "other": sorted(objects.WORDS.keys() - objects.ABSENT - {objects.READ_ONLY}),
}


def lost(on_loss: str, variant: str) -> World:
    """An arm whose outputs were on when its board lost the master."""
    world = World(variant=variant, on_loss=on_loss).up()
    world.commit(1, 1, then=0.3)
    world.lose_master()
    return world


@functools.cache
def asked(on_loss: str, variant: str) -> tuple[tuple[int, int], ...]:
    """Returns the objects that a boot reads or writes."""
    world = lost(on_loss, variant)
    world.frames()
    assert world.boot() == []
    requests = map(bytes.fromhex, world.requests())
    return tuple(dict.fromkeys((data[1] | data[2] << 8, data[3]) for data in requests))


@pytest.mark.parametrize("kind", CODES)
@pytest.mark.parametrize("board", REFUSING, ids="-".join)
def test_an_abort_at_any_object_refuses_the_board_in_words_or_does_no_harm(board: tuple[str, str], kind: str) -> None:
    """Each object is refused with one kind of code on this board, and with another one on the next board."""
    turn = (REFUSING.index(board) + list(CODES).index(kind)) % len(CODES)
    for k, (index, sub) in enumerate(asked(*board)[turn :: len(CODES)]):
        code = CODES[kind][k % len(CODES[kind])]
        world = lost(*board)
        at_board = world.board()
        pins, before = at_board.pins, len(at_board.started)
        at_board.objects.refused[index, sub] = code
        faults = world.boot()
        world.run(0.2)
        place = f"{index:04X}h sub {sub}: {code:08X}h"
        assert not at_board.pins & ~pins, place
        assert all(first == second for first, second in at_board.started[before:]), place
        assert all(f"{index:04X}h" in fault.message for fault in faults), f"{place}: {faults}"
