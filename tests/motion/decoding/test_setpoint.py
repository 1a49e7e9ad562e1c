"""Set-points from the network: which are accepted, and code and message of each refusal."""

import json
import re
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hyperbit.controller.motion.decoding.payloads import MOST_BYTES
from hyperbit.controller.motion.decoding.setpoint import TrackedSetpoint, decode
from hyperbit.controller.refusals.codes import INVALID_GOAL
from hyperbit.controller.refusals.refusal import LONGEST_SENTENCE, Refusal
from tests.motion.decoding.requests import json_values


def planar(payload: bytes) -> TrackedSetpoint:
    return decode(payload, dimension=2, tolerance=0.002)


def setpoint(**fields: Any) -> bytes:
    return json.dumps({"position": [0.5, 2.9], **fields}).encode()


REFUSED = {
    "empty payload": (b"", "setpoint is not JSON: .*char 0"),
    "no JSON": (b"{position", "setpoint is not JSON: .*char 1"),
    "two values": (setpoint() + setpoint(), "setpoint is not JSON: Extra data"),
    "no UTF-8": (b'{"stamp": "\xff"}', "setpoint is not UTF-8: byte 11 is 0xff"),
    "byte order mark": (b"\xef\xbb\xbf" + setpoint(), "setpoint is not JSON: .*BOM"),
    "no object": (b"[0.5, 2.9]", "setpoint: an object with `position` is needed"),
    "null": (b"null", "setpoint: an object with `position` is needed"),
    "no position": (b"{}", "position: required, but missing"),
    "unknown field": (setpoint(velocity=1), "velocity: unknown field; known are position, stamp, tolerance"),
    "orientation": (setpoint(orientation=0.1), "orientation: unknown field"),
    "unknown in the tolerance": (setpoint(tolerance={"angle": 1}), r"tolerance\.angle: unknown field; known are"),
    "five unknown": (setpoint(a=1, b=1, c=1, d=1, e=1), r"a: unknown.*; c: unknown.*\(and 2 more faults\)"),
    "field twice": (b'{"position": [1, 2], "position": [3, 4]}', "setpoint is not JSON: 'position' occurs twice"),
    "field with no UTF-8": (b'{"\\ud800": 1}', r"\\ud800: unknown field"),
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
    "enormous integer": (b'{"position": [1, 1%s]}' % (b"0" * 5_000), "setpoint is not JSON: Exceeds the limit"),
    "one coordinate": (setpoint(position=[1]), "position: Expected `array` of length >= 2"),
    "four coordinates": (setpoint(position=[1, 2, 3, 4]), "position: Expected `array` of length <= 3"),
    "spatial": (setpoint(position=[1, 2, 3]), "position: 3 coordinates, this arm's positions have 2"),
    "too large": (setpoint(x="x" * MOST_BYTES), r"setpoint of 100\d\d bytes, at most 10000 are accepted"),
    "deeply nested": (b"[" * 5_000 + b"]" * 5_000, "setpoint is not JSON: maximum recursion depth"),
}  # fmt: skip


@pytest.mark.parametrize(("payload", "sentence"), REFUSED.values(), ids=REFUSED.keys())
def test_refused_as_invalid_with_a_sentence(payload: bytes, sentence: str) -> None:
    with pytest.raises(Refusal) as caught:
        planar(payload)
    assert caught.value.code == INVALID_GOAL
    assert re.search(sentence, str(caught.value)), str(caught.value)


@pytest.mark.parametrize("depth", range(850, 1010, 3))
@pytest.mark.parametrize("field", [b'{"position": %s}', b'{"tolerance": %s}', b"%s"])
def test_nesting_of_any_depth_is_refused_by_a_sentence(field: bytes, depth: int) -> None:
    with pytest.raises(Refusal, match=r"setpoint|position|tolerance"):
        planar(field % (b"[" * depth + b"]" * depth))


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


numbers = st.floats() | st.integers() | json_values
setpoints = st.fixed_dictionaries(
    {"position": st.lists(numbers, max_size=4) | json_values},
    optional={"stamp": numbers, "tolerance": st.dictionaries(st.just("position"), numbers) | json_values},
)


def taken_or_refused(payload: bytes) -> None:
    try:
        taken = planar(payload)
    except Refusal as error:
        sentence = str(error)
    else:
        assert taken.position.shape == (2,)
        assert np.isfinite(taken.position).all()
        return
    assert 0 < len(sentence) <= 2 * LONGEST_SENTENCE
    assert sentence.encode()


@given(st.binary())
def test_any_bytes_are_taken_or_refused(payload: bytes) -> None:
    taken_or_refused(payload)


@given(json_values | setpoints)
def test_any_json_is_taken_or_refused(value: Any) -> None:
    taken_or_refused(json.dumps(value).encode())
