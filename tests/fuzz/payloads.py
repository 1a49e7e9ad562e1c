"""What peers send, configurations and arms' files, right ones and ones gone wrong: read, or refused in words."""

from __future__ import annotations

import json
import os
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from hypothesis import strategies as st

from controller.commands.common import parse_goal
from controller.config import load
from controller.manipulator import frames
from controller.manipulator.manipulator import Manipulator
from controller.manipulator.module import transforms
from controller.manipulator.notation import format_configuration, parse_configuration
from controller.motion import bias, degrade, goal, obstacles, setpoint
from controller.motion.codes import INVALID_GOAL, OLD_HEADER_TIMESTAMP, Refusal
from controller.motion.pacing import Pace
from controller.obstacles.notation import MOST
from controller.strict import InputFaults

NOW = 1_800_000_000.0
LONGEST = 2 * goal.LONGEST_SENTENCE + 100  # characters of a refusal; half pairs of surrogates take six to write


def told(sentence: str) -> None:
    """Expects what a person can be shown."""
    assert 0 < len(sentence) <= 6 * LONGEST, f"a sentence of {len(sentence)} characters"
    assert sentence.encode() is not None


def read_goal(data: bytes) -> int:
    """A goal, for a planar arm."""
    try:
        it = goal.schedule(goal.parse(data), dimension=2, tolerance=0.002, turn=0.05, pace=Pace(0.06), now=NOW)
    except Refusal as error:
        assert error.code in (INVALID_GOAL, OLD_HEADER_TIMESTAMP)  # noqa: PT017 - no test
        told(str(error))
        return 1
    assert it.positions.shape == (len(it.times), 2)
    assert np.isfinite(it.positions).all()
    assert np.isfinite(it.times).all()
    assert (np.diff(it.times) > 0).all()
    assert ((it.tolerances > 0) & (it.tolerances < 1e7)).all()
    assert it.waypoints[-1] == len(it.times) - 1
    return 1


def read_setpoint(data: bytes) -> int:
    """A setpoint, for an arm in space."""
    try:
        it = setpoint.decode(data, dimension=3, tolerance=0.002)
    except Refusal as error:
        told(str(error))
        return 1
    assert it.position.shape == (3,)
    assert np.isfinite(it.position).all()
    assert 0 < it.tolerance < 1e7
    return 1


def read_degrade(data: bytes) -> int:
    """A request to hold an actuator."""
    try:
        it = degrade.decode(data)
    except Refusal as error:
        told(str(error))
        return 1
    assert isinstance(it.actuator, str)
    assert it.state in (0, 1, None)
    return 1


def read_measured_tip(data: bytes) -> int:
    """A measured tip of a planar arm, and of one in space."""
    for dimension in (2, 3):
        try:
            position, stamp = bias.decode(data, dimension)
        except Refusal as error:
            told(str(error))
            continue
        assert position.shape == (dimension,)
        assert np.isfinite(position).all()
        assert 0 <= stamp < np.inf
    return 2


def read_obstacles(data: bytes) -> int:
    """Regions to keep a planar arm out of, and one in space."""
    for dimension in (2, 3):
        try:
            it = obstacles.decode(data, dimension)
        except Refusal as error:
            told(str(error))
            continue
        assert len(it) == len(it.kinds) == len(it.axes) == len(it.centres) == len(it.sizes) <= MOST
        assert np.isfinite(it.depths([[0.0, 0.0, 0.0], [0.5, -3.0, 0.0]])).all()
        assert all(it.names)
    return 2


def arm_of(*states: int) -> Manipulator:
    """An arm whose modules have so many states."""
    return Manipulator([transforms([frames.planar(k, 1) for k in range(n)], planar=True) for n in states])


ARMS = (arm_of(8, 8, 2), arm_of(12, 2, 2))


def read_notation(data: bytes) -> int:
    """What a person writes on the command line: a configuration, and a position."""
    text = data.decode("utf-8", "surrogateescape")
    for arm in ARMS:
        try:
            configuration = parse_configuration(arm, text)
        except ValueError as error:
            assert str(error).startswith("configuration ")  # noqa: PT017 - no test
            continue
        assert parse_configuration(arm, format_configuration(arm, configuration)).tolist() == configuration.tolist()
    try:
        assert np.isfinite(parse_goal(text, 2, "--goal")[0]).all()
    except InputFaults as error:
        assert all(error.faults)  # noqa: PT017 - no test
    return 1


class ReadArm:
    """An arm's file."""

    def __init__(self) -> None:
        room = "/dev/shm" if os.access("/dev/shm", os.W_OK) else "/tmp"
        self.path = Path(room) / f"hyperbit-fuzz-{os.getpid()}.yaml"

    def __call__(self, data: bytes) -> int:
        try:
            self.path.write_bytes(data)
            arm = load(self.path)
        except InputFaults as error:
            assert error.faults  # noqa: PT017 - no test
            for fault in error.faults:
                assert "\n" not in fault, fault
                told(fault)
            return 1
        finally:
            self.path.unlink(missing_ok=True)
        assert np.isfinite(arm.manipulator.frames).all()
        assert len(arm.wiring) in (0, len(arm.manipulator.actuators))
        assert np.isfinite(arm.weights()).all()
        assert arm.level_pixels >= 1
        assert arm.clearance().blocked(np.zeros((1, len(arm.manipulator.modules)), dtype=int)).shape == (1,)
        return 1


# --- right ones

GOAL: dict[str, Any] = {
    "id": "a-1",
    "stamp": NOW + 1,
    "waypoints": [{"t": 0.0, "position": [0.55, 2.9]}, {"t": 0.5, "position": [0.5, 2.8]}],
    "tolerance": {"position": 0.002},
}
LINE: dict[str, Any] = {**GOAL, "path_tolerance": 0.01}
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
NOTATIONS = ["071", "0,7,1", "11,0,1", " 0,1,1\n", "0.55,2.9", "1e-3,-2", "-1,0,0", "1_0,1,1", "٣,0,1", "9" * 5000]


def written(value: Any) -> bytes:
    """As JSON, which is YAML, too."""
    return json.dumps(value).encode()


def plain(value: Any) -> bytes:
    """As YAML without aliases."""
    return yaml.safe_dump(json.loads(json.dumps(value)), default_flow_style=None).encode()


# --- gone wrong

AWKWARD: list[Any] = [
    None, True, False, 0, -1, 1, 2, 63, 64, 126, 127, 10_000, 10_001, 1 << 64, -(1 << 63), 10**400,
    0.0, -0.0, 1e-9, 5e-324, 1e6, 1e308, -1e308, float("nan"), float("inf"), -float("inf"),
    "", "a", "1", "nan", "can0", "vgt", "\ud800", "x" * 2000, "\0", "\n", [], {}, [[]], [0, 0], [1, 2, 3, 4], {"": 0},
]  # fmt: skip


def places(value: Any, at: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """The paths of all parts of a value."""
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [at, *(path for key, part in inner for path in places(part, (*at, key)))]


def spoil(value: Any, chance: random.Random) -> Any:
    """Returns a value with one part of it changed, left out, doubled, misnamed, moved or nested."""
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
    """What spoils a payload that is JSON once or more, or else one of the right values."""

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
    """Payloads: right values spoiled, text of them cut and pasted, and any bytes."""
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


texts = st.sampled_from(NOTATIONS) | st.text("0123456789,-+._ e", max_size=12) | st.text(max_size=12)
notations = texts.map(lambda text: text.encode("utf-8", "surrogatepass"))
