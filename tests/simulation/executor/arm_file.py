"""Writes a drawn arm as an arm's file, and reads it as the executor does: the file and the arm tell the same."""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import asdict, replace
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import Any

import pytest

from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.executor.arm.arm import ExecutedArm, read_arm
from hyperbit.drivers.canopen.wiring import Channel, Timing
from tests.simulation.verdict import require

WORDS = ("contracted", "extended")
STAGE = 0.1  # [s] of a stage of the contraction at the end, beside its travel, margin and rest
MOST_BYTES = 32  # of the inputs of one board, in four PDOs


def judge_file(drawn: ExecutedArm, random: Random) -> None:
    """Requires that the executor reads a drawn arm from its file, and refuses one that does not fit its boards."""
    wiring = drawn.wiring
    holds = all(c.pulse is None and (c.on_loss or wiring.on_loss) == "hold" for c in wiring.channels)
    state = random.choice([None, "device", "hold"]) if holds else None
    nodes = tuple(replace(node, error_state=state and random.choice(["device", "hold"])) for node in wiring.nodes)
    drawn = replace(drawn, wiring=replace(wiring, error_state=state, nodes=nodes))  # type: ignore[arg-type]
    with TemporaryDirectory(prefix="arm-") as folder:
        path, real_time = Path(folder, "arm.yaml"), random.choice([None, random.randint(1, 98)])
        fields = _fields(drawn, real_time)
        path.write_text(json.dumps(fields))
        read = read_arm(path)
        _compare(_expected(drawn), read)
        require(read.digest == hashlib.sha256(path.read_bytes()).hexdigest(), "the digest is not that of the file")
        told = None if read.real_time is None else read.real_time.priority
        require(told == real_time, f"the priority is read as {told}, the file has {real_time}")
        board = {key: fields["actuators"][0][key] for key in ("bus", "node")}
        more = {f"more{i}": {**board, "input": 8 * i} for i in range(MOST_BYTES, 2 * MOST_BYTES + 1)}
        fields["interlocks"] = {**fields["interlocks"], **more}
        path.write_text(json.dumps(fields))
        with pytest.raises(InputFaults, match=rf"interlocks\.more\d+\.input: \d+, but board .* {MOST_BYTES} fit"):
            read_arm(path)


def _fields(arm: ExecutedArm, real_time: int | None) -> dict[str, Any]:
    wiring, timing = arm.wiring, arm.timing
    fields: dict[str, Any] = {
        "name": arm.name,
        "modules": [{"type": "prismatic", "axis": [1.0, 0.0], "lengths": [0.0, 1.0], "count": len(arm.actuators)}],
        "tolerance": {"position": 0.001},
        "travel_time": timing.travel_time,
        "rest_time": arm.rest,
        "planner_timeout": arm.planner_timeout,
        "on_stuck": "continue" if arm.continue_on_stuck else "hold",
        "on_stop": "contract" if arm.contract_on_stop else "hold",
        "boards": {
            "heartbeat": timing.heartbeat,
            "heartbeat_timeout": timing.heartbeat_timeout,
            "boot_timeout": timing.boot_timeout,
            "settle_margin": timing.settle_margin,
            "on_loss": wiring.on_loss,
            "shared_rpdo": wiring.shared_rpdo,
            "nodes": [
                {key: value for key, value in asdict(node).items() if value is not None} for node in wiring.nodes
            ],
        },
        "buses": [
            {"name": b.name, "interface": "virtual", "channel": b.channel, "bitrate": b.bitrate} for b in wiring.buses
        ],
        "actuators": [_actuator(arm, k, channel) for k, channel in enumerate(wiring.channels)],
        "interlocks": {
            lock.name: {"bus": lock.bus, "node": lock.node, "input": lock.bit, "inverted": lock.inverted}
            for lock in wiring.interlocks
        },
    }
    if wiring.error_state is not None:
        fields["boards"]["error_state"] = wiring.error_state
    if arm.inrush is not None:
        fields["inrush"] = arm.inrush
    if real_time is not None:
        fields["real_time"] = {"priority": real_time}
    return fields


def _actuator(arm: ExecutedArm, k: int, channel: Channel) -> dict[str, Any]:
    entry: dict[str, Any] = {"module": k + 1, "actuator": "1", "bus": channel.bus, "node": channel.node}
    boards = {"input": channel.input_board, "input_contracted": channel.input_contracted_board}
    for name in ("output", "output_off", "input", "input_contracted"):
        bit, board = getattr(channel, name), boards.get(name)
        if bit is not None:
            entry[name] = {"bit": bit, "inverted": name in channel.inverted}
            entry[name] |= {} if board is None else {"board": str(board)}
    if channel.travel is not None:
        entry["travel_time"] = {"contract": channel.travel[0], "extend": channel.travel[1]}
    for name in ("pulse", "settle_margin", "on_loss"):
        if getattr(channel, name) is not None:
            entry[name] = getattr(channel, name)
    if arm.locked >> k & 1:
        entry["stuck"] = WORDS[arm.locked_states >> k & 1]
    return entry


def _expected(arm: ExecutedArm) -> ExecutedArm:
    """Returns the arm as its file tells it: labels by module, and times for each actuator."""
    wiring, timing = arm.wiring, arm.timing
    both = timing.travel_time, timing.travel_time
    channels = [
        replace(
            channel,
            actuator=f"{k + 1}.1",
            travel=both if channel.travel is None else channel.travel,
            inverted=frozenset(name for name in channel.inverted if getattr(channel, name) is not None),
        )
        for k, channel in enumerate(wiring.channels)
    ]
    longest = max(max(both if channel.travel is None else channel.travel) for channel in wiring.channels)
    margin = max([timing.settle_margin, *(channel.settle_margin or 0.0 for channel in wiring.channels)])
    stages = 2 * math.ceil(len(channels) / (arm.inrush or len(channels))) + 1
    buses = tuple(replace(bus, interface="virtual") for bus in wiring.buses)
    return replace(
        arm,
        wiring=replace(wiring, buses=buses, channels=tuple(channels)),
        timing=replace(timing, travel_time=longest),
        locked_states=arm.locked_states & arm.locked,
        ending=stages * (longest + margin + arm.rest + STAGE) if arm.contract_on_stop else 0.0,
    )


def _compare(expected: ExecutedArm, read: ExecutedArm) -> None:
    for name in ExecutedArm.__dataclass_fields__:
        if name in ("digest", "real_time"):
            continue
        right, told = getattr(expected, name), getattr(read, name)
        if isinstance(right, float):
            require(abs(right - told) < 1e-9, f"{name} is read as {told}, the file has {right}")
        elif isinstance(right, Timing):
            require(asdict(right) == asdict(told), f"{name} is read as {told}, the file has {right}")
        else:
            require(right == told, f"{name} is read as {told}, the file has {right}")
    require(expected.most == read.most, f"{read.most} may switch at once, {expected.most} are right")
