"""Set-points from the network: which are accepted, and code and message of each refusal."""

import json
import re
from typing import Any

import pytest

from hyperbit.controller.motion.decoding.setpoint import TrackedSetpoint, decode
from hyperbit.controller.refusals.codes import INVALID_GOAL
from hyperbit.controller.refusals.refusal import Refusal


def planar(payload: bytes) -> TrackedSetpoint:
    return decode(payload, dimension=2, tolerance=0.002)


def setpoint(**fields: Any) -> bytes:
    return json.dumps({"position": [0.5, 2.9], **fields}).encode()


REFUSED = {
    "no position": (b"{}", "position: required, but missing"),
    "unknown field": (setpoint(velocity=1), "velocity: unknown field; known are position, stamp, tolerance"),
    "orientation": (setpoint(orientation=0.1), "orientation: unknown field"),
    "unknown in the tolerance": (setpoint(tolerance={"angle": 1}), r"tolerance\.angle: unknown field; known are"),
    "five unknown": (setpoint(a=1, b=1, c=1, d=1, e=1), r"a: unknown.*; c: unknown.*\(and 2 more faults\)"),
    "field twice": (b'{"position": [1, 2], "position": [3, 4]}', "setpoint is not JSON: 'position' occurs twice"),
    "number with no UTF-8": (b'{"position": [1, "\\ud800"]}', r"position\[1\]: a lone surrogate is no text"),
    "long field": (setpoint(**{"x" * 5_000: 1}), r"^x{997}\.\.\.$"),
    "text for a number": (setpoint(position=["1", 2]), r"position\[0\]: Expected `float`, got `str` \(given: '1'\)"),
    "truth for a number": (setpoint(position=[1, True]), r"position\[1\]: Expected `float`, got `bool`"),
    "null for a number": (setpoint(stamp=None), "stamp: Expected `float`, got `null`"),
    "position no list": (setpoint(position=1), "position: Expected `array`"),
    "tolerance no object": (setpoint(tolerance=0.01), "tolerance: Expected `object`"),
    "NaN": (b'{"position": [1, NaN]}', r"position\[1\]: nan is not a finite number"),
    "Infinity": (b'{"position": [-Infinity, 1]}', r"position\[0\]: -inf is not a finite number"),
    "1e999": (b'{"position": [1, 1e999]}', r"position\[1\]: inf is not a finite number"),
    "NaN as stamp": (b'{"position": [1, 2], "stamp": NaN}', "stamp: nan is not a finite number"),
    "infinite stamp": (b'{"position": [1, 2], "stamp": 1e999}', "stamp: inf is not a finite number"),
    "NaN as tolerance": (b'{"position": [1, 2], "tolerance": {"position": NaN}}', r"tolerance\.position: nan is not"),
    "negative stamp": (setpoint(stamp=-1), "stamp: Expected `float` >= 0"),
    "no tolerance": (setpoint(tolerance={"position": 0}), r"tolerance\.position: Expected"),
    "tolerance of the orientation": (setpoint(tolerance={"orientation": 0.1}), r"tolerance\.orientation: this arm"),
    "far away": (setpoint(position=[1, 1e300]), r"position\[1\]: Expected `float` <= 1000000"),
    "huge integer": (b'{"position": [1, 1%s]}' % (b"0" * 400), r"position\[1\]: Number out of range"),
    "one coordinate": (setpoint(position=[1]), "position: Expected `array` of length >= 2"),
    "four coordinates": (setpoint(position=[1, 2, 3, 4]), "position: Expected `array` of length <= 3"),
    "spatial": (setpoint(position=[1, 2, 3]), "position: 3 coordinates, this arm's positions have 2"),
}  # fmt: skip


@pytest.mark.parametrize(("payload", "sentence"), REFUSED.values(), ids=REFUSED.keys())
def test_refused_as_invalid_with_a_sentence(payload: bytes, sentence: str) -> None:
    with pytest.raises(Refusal) as caught:
        planar(payload)
    assert caught.value.code == INVALID_GOAL
    assert re.search(sentence, str(caught.value)), str(caught.value)


def test_an_arm_in_space_takes_three_coordinates() -> None:
    assert decode(setpoint(position=[1, 2, 3]), dimension=3, tolerance=0.002).position.tolist() == [1, 2, 3]
    with pytest.raises(Refusal, match="position: 2 coordinates, this arm's positions have 3"):
        decode(setpoint(), dimension=3, tolerance=0.002)


@pytest.mark.parametrize("stamp", [{}, {"stamp": 0}, {"stamp": 0.0}])
def test_without_a_stamp_it_is_of_its_arrival(stamp: dict[str, float]) -> None:
    taken = planar(setpoint(**stamp))
    assert (taken.position.tolist(), taken.stamp, taken.tolerance) == ([0.5, 2.9], None, 0.002)


def test_stamp_and_tolerance_are_taken_over() -> None:
    taken = planar(setpoint(stamp=1_800_000_000.125, tolerance={"position": 0.01}))
    assert (taken.stamp, taken.tolerance) == (1_800_000_000.125, 0.01)
    assert planar(setpoint(tolerance={})).tolerance == 0.002
