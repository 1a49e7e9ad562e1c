"""Obstacles from the network: decoding."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hyperbit.controller.motion.decoding.requests import MOST_OBSTACLE_BYTES, decode_obstacles
from hyperbit.controller.refusals.refusal import Refusal
from tests.motion.decoding.requests import scalars, unreadable

fields = ["disc", "sphere", "box", "half_plane", "name", "centre", "radius", "size", "angle", "point", "normal"]
anything = st.recursive(
    scalars, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.sampled_from(fields), inner, max_size=4)
)
NAMED = {"disc": {"centre": [1, 2], "radius": 0.5}, "name": "crate"}


def sent(*regions: object) -> bytes:
    return json.dumps({"regions": regions}).encode()


@pytest.mark.parametrize(
    ("payload", "named"),
    [
        (b"{}", "regions: required, but missing"),
        (b"[]", "obstacles: an object with `regions` is needed"),
        *unreadable("obstacles", MOST_OBSTACLE_BYTES),
        (b'{"regions": [], "now": 1}', "now: unknown field; known are regions"),
        (sent({"sphere": {"centre": [1, 2], "radius": 1}}), "regions[0]: one of disc, box, half_plane is needed for"),
        (sent({"disc": {"centre": [1, 2, 3], "radius": 1}}), "regions[0].disc.centre: 3 coordinates, a planar arm's"),
        (sent({"disc": {"centre": [1, 2], "radius": 0}}), "regions[0].disc.radius: Expected `float` > 0.0"),
        (sent(NAMED, NAMED), "regions[1].name: 'crate' is the name of another obstacle already"),
        (sent({}, {}, {}, {}), "regions[0]: one of disc"),
    ],
)
def test_what_is_wrong_with_a_request_is_named_by_field(payload: bytes, named: str) -> None:
    with pytest.raises(Refusal) as refused:
        decode_obstacles(payload, 2)
    assert str(refused.value).startswith(named)


def test_regions_are_taken_in_their_order() -> None:
    assert decode_obstacles(sent(NAMED, {"box": {"centre": [1, 2], "size": [1, 2]}}), 2).names == (
        "disc 'crate'",
        "box regions[1]",
    )
    assert len(decode_obstacles(sent(), 3)) == 0


def test_more_than_three_faults_are_counted() -> None:
    with pytest.raises(Refusal, match="and 1 more faults"):
        decode_obstacles(sent({}, {}, {}, {}), 2)


@given(st.binary(max_size=60) | st.lists(anything, max_size=3).map(lambda value: sent(*value)), st.sampled_from([2, 3]))
def test_whatever_bytes_come_are_regions_or_refused(payload: bytes, dimension: int) -> None:
    try:
        regions = decode_obstacles(payload, dimension)
    except Refusal:
        return
    assert len(regions) == len(json.loads(payload)["regions"])
