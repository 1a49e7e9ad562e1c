"""Valid requests and arms' files, and mutations of them."""

from __future__ import annotations

import json
import random
from collections.abc import Callable
from typing import Any

import yaml
from hypothesis import strategies as st

NOW = 1_800_000_000.0

GOAL: dict[str, Any] = {
    "id": "a-1",
    "stamp": NOW + 1,
    "waypoints": [{"t": 0.0, "position": [0.55, 2.9]}, {"t": 0.5, "position": [0.5, 2.8]}],
    "tolerance": {"position": 0.002},
}
LINE: dict[str, Any] = {**GOAL, "path_tolerance": 0.01}
CONFIGURATIONS: dict[str, Any] = {"waypoints": [{"t": 0, "configuration": "071"}, {"t": 1, "configuration": "0,7,0"}]}
JOG: dict[str, Any] = {"actuators": {"1.left": "extended", "2.right": "contracted"}}
SETPOINT: dict[str, Any] = {"position": [0.55, 2.9, 0.1], "stamp": NOW, "tolerance": {"position": 0.002}}
DEGRADE: dict[str, Any] = {"actuator": "5.left", "state": 0}
MEASURED_TIP: dict[str, Any] = {"position": [0.55, 2.9], "stamp": NOW, "orientation": 0.1}
OBSTACLES: dict[str, Any] = {
    "regions": [
        {"disc": {"centre": [1.0, 2.0], "radius": 0.3}, "name": "pillar"},
        {"box": {"centre": [-1, 1], "size": [0.4, 0.2], "angle": 0.5}},
        {"half_plane": {"point": [0, -0.2], "normal": [0, 1]}, "name": "floor"},
    ]
}
OBSTACLES_IN_SPACE: dict[str, Any] = {
    "regions": [
        {"sphere": {"centre": [1.0, 2.0, 0.5], "radius": 0.3}},
        {"box": {"centre": [-1, 1, 2], "size": [0.4, 0.2, 1], "orientation": [0, 0.6, 0, 0.8]}},
        {"half_space": {"point": [0, 0, -0.2], "normal": [0, 0, 1]}},
    ]
}
ARM: dict[str, Any] = {
    "name": "short",
    "modules": [
        {"type": "vgt", "count": 2, "width": 0.2, "lengths": [0.2, 0.25], "first_diagonal": "BC"},
        {"type": "vgt", "width": 0.2, "lengths": {"left": [0.2, 0.25], "diagonal": [0.3, 0.35], "right": [0.2, 0.25]}},
        {"type": "transforms", "states": [{"position": [0, 0.2]}, {"position": [0.1, 0.2], "orientation": 0.5}]},
    ],
    "base": {"position": [0.5, 0.25], "orientation": 0.1},
    "tolerance": {"position": 0.002},
    "inrush": 4,
    "obstacles": [*OBSTACLES["regions"]],
    "body_radius": 0.01,
    "self_collision": True,
    "weights": {"base": 2, "wear": 1},
    "workspace": {"pixel": 0.01, "memory": 512},
    "buses": [{"name": "can0", "channel": "can0", "bitrate": 500000}],
    "boards": {"heartbeat": 0.1, "heartbeat_timeout": 0.35, "on_loss": "hold"},
    "actuators": [
        *(
            {"module": m + 1, "actuator": name, "bus": "can0", "node": m + 1, "output": k, "input": k}
            for m in range(3)
            for k, name in enumerate(("left", "diagonal", "right"))
        ),
        {"module": 4, "actuator": "1", "bus": "can0", "node": 4, "output": 0},
    ],
}
SPATIAL = {
    "name": "s",
    "modules": [{"type": "transforms", "states": [{"position": [0, 0, 1], "orientation": [0, 0, 0, 1]}] * 2}],
    "tolerance": {"position": 1},
    "obstacles": [*OBSTACLES_IN_SPACE["regions"]],
}


def written(value: Any) -> bytes:
    return json.dumps(value).encode()


def plain(value: Any) -> bytes:
    """Returns a value as YAML without aliases."""
    return yaml.safe_dump(json.loads(json.dumps(value)), default_flow_style=None).encode()


AWKWARD: list[Any] = [
    None, True, False, 0, -1, 1, 2, 63, 64, 126, 127, 10_000, 10_001, 1 << 64, -(1 << 63), 10**400,
    0.0, -0.0, 1e-9, 5e-324, 1e6, 1e308, -1e308, float("nan"), float("inf"), -float("inf"),
    "", "a", "1", "nan", "can0", "vgt", "\ud800", "x" * 2000, "\0", "\n", [], {}, [[]], [0, 0], [1, 2, 3, 4], {"": 0},
]  # fmt: skip


def places(value: Any, at: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [at, *(path for key, part in inner for path in places(part, (*at, key)))]


def spoil(value: Any, chance: random.Random) -> Any:
    """Returns a value with one part changed, omitted, duplicated, renamed, moved or nested."""
    value = json.loads(json.dumps(value))
    path = chance.choice(places(value))
    if not path:
        return chance.choice([value, [value], *AWKWARD])
    *way, key = path
    room = value
    for step in way:
        room = room[step]
    match chance.randrange(8):
        case 0:
            del room[key]
        case 1 if isinstance(room, list):
            room[key:key] = [room[key]] * chance.choice([1, 2, 9])
        case 1 | 2 if isinstance(room, dict):
            room[chance.choice([f"{key}s", "", "type", "count", "\ud800"])] = room[key]
        case 3:
            room[key] = [room[key]]
        case 4 if isinstance(room[key], int | float) and not isinstance(room[key], bool):
            room[key] *= chance.choice([-1, 0.5, 2, 1000, 1e-12, 1e12])
        case _:
            room[key] = chance.choice(AWKWARD)
    return value


def spoiler(*right: Any) -> Callable[[bytes, random.Random], bytes]:
    """Returns a mutation of a JSON payload, or of a valid value if the payload is no JSON."""

    def spoiled(data: bytes, chance: random.Random) -> bytes:
        try:
            value = json.loads(data)
            places(value)
        except (ValueError, RecursionError):
            value = chance.choice(right)
        for _ in range(chance.choice([1, 1, 1, 2, 4])):
            try:
                value = spoil(value, chance)
            except (ValueError, OverflowError, RecursionError):  # JSON with numbers that cannot be written again
                value = chance.choice(right)
        return written(value)

    return spoiled


def wrong(*right: Any) -> st.SearchStrategy[bytes]:
    """Strategy of payloads: mutated valid values, spliced texts, and random bytes."""
    spoiled = spoiler(*right)
    seeds = [written(value) for value in right]
    values = st.builds(
        lambda seed, number: spoiled(seed, random.Random(number)), st.sampled_from(seeds), st.integers(0)
    )
    torn = st.builds(
        lambda data, at, length, other: data[: at % len(data)] + other + data[at % len(data) + length :],
        st.sampled_from(seeds), st.integers(0, 10_000), st.integers(0, 40), st.binary(max_size=8),
    )  # fmt: skip
    return values | torn | st.binary(max_size=200)
