"""Objects of a boot are refused with abort codes: the board boots, or the sentence names the object.

The codes of absent objects are tried at each object, each other code at every twelfth object.
"""

from __future__ import annotations

import functools

import pytest

from hyperbit.drivers.canopen.sdo import objects
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.simulation.variants import VARIANTS
from tests.drivers.canopen.boot.test_pins import boot, extended
from tests.drivers.rig import World

BOARDS = {"hold": ("standard", "guarding-only", "many-outputs"), "contract": ("standard", "guarding-with-1029h")}

CODES = sorted(objects.WORDS)
SPECIAL = objects.ABSENT | {objects.READ_ONLY}  # the boot goes on after some of them


def lost(on_loss: str, variant: str) -> World:
    """An arm whose outputs were on when its board lost the master."""
    return extended(variants={"can0/5": VARIANTS[variant]}, on_loss=on_loss)


@functools.cache
def asked(on_loss: str, variant: str) -> tuple[tuple[int, int], ...]:
    world = lost(on_loss, variant)
    world.frames(sdo=True)
    assert boot(world) == []
    requests = (bytes.fromhex(data) for cob_id, data in world.frames(sdo=True) if cob_id == cia301.SDO_REQUEST + 5)
    return tuple(dict.fromkeys((data[1] | data[2] << 8, data[3]) for data in requests))


@pytest.mark.parametrize("code", CODES, ids=lambda code: f"{code:08X}h")
@pytest.mark.parametrize("on_loss", BOARDS)
def test_an_abort_at_any_object_refuses_the_board_in_words_or_does_no_harm(on_loss, code):
    variant = BOARDS[on_loss][code % len(BOARDS[on_loss])]
    step = 1 if code in SPECIAL else 12
    for index, sub in asked(on_loss, variant)[CODES.index(code) % step :: step]:
        world = lost(on_loss, variant)
        board = world.boards.board("can0/5")
        pins, before = board.pins, len(board.started)
        board.objects.refused[index, sub] = code
        faults = boot(world)
        world.run(0.2)
        place = f"{index:04X}h sub {sub}: {code:08X}h"
        assert not board.pins & ~pins, place
        assert all(first == second for first, second in board.started[before:]), place
        for sentence in faults:
            assert f"{index:04X}h" in sentence, f"{place}: {sentence}"
