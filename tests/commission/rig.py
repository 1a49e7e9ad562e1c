"""An arm of four actuators on two boards whose wiring differs from its file, and a person who sees it move."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from msgspec.structs import replace

from hyperbit.controller.armfile.actuators import read_wired
from hyperbit.controller.armfile.commissioned import Sighting
from hyperbit.controller.commission.session import Session
from hyperbit.controller.executor.arm.arm import read_arm
from hyperbit.controller.program import Ended, Reset, Trial
from tests.executor.rig import World

Entry = dict[str, Any]
LABELS = ("1.1", "1.2", "2.1", "2.2")
OUTPUTS = {
    "one output": {},
    "pair": {"output_off": 8},
    "pulses": {"output_off": 8, "pulse": 0.1},
}
ENDS = {"no end": (), "extended end": ("input",), "contracted end": ("input_contracted",)}
ENDS["both ends"] = ("input", "input_contracted")


def entries(outputs: str, ends: str) -> dict[str, Entry]:
    """Returns the wiring of each actuator of a kind, by label: outputs 0, 1 and 8, 9; inputs 0, 1 and 4, 5."""
    made = {}
    for label in LABELS:
        module, name = label.split(".")
        k = int(name) - 1
        entry: Entry = {"module": int(module), "actuator": name, "bus": "can0", "node": int(module), "output": k}
        entry |= {field: value + k if isinstance(value, int) else value for field, value in OUTPUTS[outputs].items()}
        entry |= {field: k + 4 * (field != "input") for field in ENDS[ends]}
        made[label] = entry
    return made


def write_arm(path: Path, wiring: dict[str, Entry]) -> Path:
    modules = [{"type": "revolute", "cylinders": [[0, 1], [0, 1]], "link": {"position": [1, 0]}, "count": 2}]
    buses = [{"name": "can0", "channel": "can0", "interface": "virtual"}]
    arm = {"name": "small", "modules": modules, "tolerance": {"position": 0.1}, "buses": buses}
    path.write_text(json.dumps({**arm, "actuators": list(wiring.values())}, indent=1))
    return path


def commissioned(folder: Path, file: dict[str, Entry], truth: dict[str, Entry], *faults: str) -> Session:
    """Commissions an arm on boards that are wired as `truth` says; returns the session. `faults`: of the boards."""
    path, true = write_arm(folder / "arm.yaml", file), write_arm(folder / "true.yaml", truth)
    settings, labels, wired = read_wired(path)
    session = Session(path, settings.name, labels, wired)
    world = World(arm=read_arm(path), wired=read_arm(true).wiring)
    for fault in faults:
        world.fault(*fault.split())
    world.go(2.0)
    world.leave()
    world.connect(role="commissioner")
    world.go(1.0)
    if world.mode == "fault":  # end-stops that cannot be right, before anybody commissioned them
        world.send(Reset(1, world.epoch))
        world.go(1.0)
    for _ in range(2):
        for label in session.todo():
            first = 1 ^ world.states >> LABELS.index(label) & 1
            for state in (first, 1 - first):
                session.add(look(world, session, label, state))
    assert not world.core.modes.faults
    return session


def look(world: World, session: Session, label: str, state: int) -> Sighting:
    """Tries an actuator, and says what a person sees: what has moved, and which lamps of its valve are lit."""
    number, before = world.core.requests.greatest + 1, world.boards.positions()
    world.send(Trial(number, world.epoch, LABELS.index(label), state, 0.3, world.now + 1.0))
    world.go(0.6)
    ended = world.last(Ended)
    assert (ended.program, ended.status) == (number, "done"), ended
    after = world.boards.positions()
    moved = [k for k in range(len(LABELS)) if round(before[k]) != round(after[k])]
    seen = session.sighting(label, state, ended)
    if moved:
        assert len(moved) == 1, "one command moves several actuators"
        seen = replace(seen, moved=LABELS[moved[0]], to=round(after[moved[0]]))
    lamps = world.boards.coils()[LABELS.index(label)] if "output_off" in session_fields(session, label) else None
    return replace(seen, lamps=lamps)


def session_fields(session: Session, label: str) -> set[str]:
    entry = session.entries[label]
    return {name for name in ("output", "output_off", "input", "input_contracted") if getattr(entry, name) is not None}
