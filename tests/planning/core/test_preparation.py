"""Prepared searches: when they begin."""

from __future__ import annotations

import math

import pytest

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.planning.core.goals import IDLE, REHEARSE_EVERY, Preparation
from hyperbit.controller.planning.core.tasks import Done, PrepareSearch
from tests.planning.rig.played_core import PlayedCore


def test_a_search_is_prepared_after_a_pause_and_the_next_look_comes_a_rehearsal_later(small: Arm) -> None:
    played = PlayedCore(small)
    played.show()
    preparation = Preparation(played.parts, played.premises, played.programs, prepares=True)
    preparation.begin(None)
    assert preparation.advance() == played.now + IDLE
    played.advance(IDLE)
    assert preparation.advance() == math.inf
    number, _ = played.task(PrepareSearch)
    played.answer(number, Done())
    assert preparation.advance() == pytest.approx(played.now + REHEARSE_EVERY, abs=1e-9)
