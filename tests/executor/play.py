"""Plays the executor's scenarios: their steps, and what is seen after each.

After each step these are as told, and where nothing is told they have not changed: the mode, commanded states, results,
declined programs, and whether the executor has ended. Other facts are compared where they are told.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

from hyperbit.controller.executor.core.events import ExecutorTick
from hyperbit.controller.host.process import Quit
from hyperbit.controller.program import (
    Answer,
    Begun,
    Cancel,
    Clearance,
    Declined,
    Ended,
    Goodbye,
    Lock,
    Question,
    Replaced,
    Replacement,
    Reset,
    Settled,
    Stage,
    Stop,
    Trial,
    pack,
    unpack,
)
from hyperbit.drivers.canopen.faults import ArmFault
from tests.executor.rig import ALL, CAN, LOST, OPERATOR, OTHER, PLANNER, SIZE, TICK, TRAVEL, Rig, World
from tests.executor.scenario import fields_of, states_of
from tests.scenario import Scenario, matches

MODES = ("starting", "ready", "executing", "fault", "stopped")
STATUSES = ("done", "aborted", "canceled", "replaced")
CLIENTS = {"planner": PLANNER, "other": OTHER, "operator": OPERATOR}
MASTER: dict[str, dict[str, Any]] = {  # what the played master does
    "SYNC waits": {"slow_sync": True},
    "SYNC goes": {"slow_sync": False},
    "RPDOs wait": {"slow_rpdos": True},
    "RPDOs go": {"slow_rpdos": False},
    "bus busy": {"busy": True},
    "bus free": {"busy": False},
    "boards silent": {"answers": False},
    "boards answer": {"answers": True},
    "boards back": {"back": True},
    "boots long": {"boots_long": True},
    "boots end": {"boots_long": False},
    "boots fail": {"boot_faults": [LOST]},
    "boots fail twice": {"boot_faults": [LOST, ArmFault("board-missing", "can0/2", "another")]},
    "pause found": {"pause": ArmFault("halted", "executor", "halted for 3 s")},
}
MASKS = {  # of the parts of the played master
    "outputs": "outputs.commanded",
    "unread": "outputs.unread",
    "missed": "outputs.missed",
    "inputs": "inputs.levels",
    "known": "inputs.known",
    "partly": "switching.partly",
}


class Play:
    """Plays a scenario on an executor, and compares what is seen."""

    def __init__(self, scenario: Scenario, kind: type[Rig] | type[World]) -> None:
        self.scenario = scenario
        self.rig: Any = kind(**fields_of(scenario.settings))
        self.boards = kind is World
        self.requests = 0
        if "from the start" not in scenario.settings:
            if not self.boards:
                self.rig.connect()
            self.rig.go(2.0 if self.boards else 3 * TICK)
            assert self.rig.mode == "ready", self.rig.reason
            if not self.boards:
                self.rig.go(TRAVEL)  # switches of the executor before would have settled

    def run(self, path: Path) -> None:
        ended = False
        for line in self.scenario.lines:
            try:
                self.mode, self.at = self.rig.mode, self.rig.now
                self.heard, self.commits, self.booted = len(self.rig.heard), len(self.switched), self.booted_so_far
                self.driven = self.rig.driven if self.boards else 0
                self._step(line.step)
                ended |= "ended" in line.seen
                self._compare(line.seen, ended)
            except Exception as error:
                error.add_note(f"{path}:{line.number}: {line.step} -> {' | '.join(line.seen)}")
                results = [f"{ended.status} {ended.program}" for ended in self.new(Ended)]
                error.add_note(f"seen: {self.rig.mode} | switch {' '.join(self.switches())} | {' | '.join(results)}")
                raise

    # --- steps

    def _step(self, step: str) -> None:
        rig = self.rig
        text, _, said = step.partition(": ")
        verb, *words = text.split()
        client = PLANNER
        if verb in CLIENTS and words and words[0] in ("stop", "reset"):
            client, verb, words = CLIENTS[verb], words[0], words[1:]
        self.requests += 1
        if step in MASTER:
            for name, value in MASTER[step].items():
                setattr(rig.master, name, value)
            return
        match verb, words:
            case "wait", _:
                rig.go(float(words[0]) if words else TICK)
            case "stand", ["still", seconds]:
                rig.executor.stall(float(seconds)) if self.boards else rig.agenda.run(float(seconds))
            case "tick", []:
                rig.do(ExecutorTick())
            case "run", _:
                states, fields = self._program(words)
                rig.run(*states, **fields)
            case "replace", [generation, "from", first, "at", start, *stages]:
                _, fields = self._program(stages)
                final, strict = fields.get("final", True), fields.get("strict", False)
                start_packed = pack(states_of(start), SIZE)
                timed = fields.get("stages", ())
                program = int(fields.get("number", rig.programs))
                rig.send(Replacement(program, int(generation), int(first), start_packed, timed, final, strict))
            case "follow", [stream, *stages]:
                states, fields = self._program(stages)
                rig.follow(int(stream), *states, **fields)
            case "stop", _:
                rig.send(Stop(self.requests), client)
            case "reset", _:
                rig.send(Reset(self.requests, rig.epoch - len(words)), client)  # "reset late": of the epoch before
            case "cancel", _:
                rig.send(Cancel(self.requests, int(words[0]) if words else None, said or "canceled; the arm holds"))
            case "commissioner", ["connects"]:
                rig.connect(PLANNER, "commissioner")
            case "try", [actuator, state, *more]:  # "epoch 3", "until -1", "watch 0.5"
                given = dict(zip(more[::2], map(float, more[1::2]), strict=True))
                rig.programs += 1
                until, epoch = rig.now + given.get("until", 1.0), int(given.get("epoch", rig.epoch))
                watch = given.get("watch", 0.2)
                rig.send(Trial(rig.programs, epoch, int(actuator), int(state), watch, until))
            case "lock", [actuator, state]:
                rig.send(Lock(self.requests, int(actuator), int(state)))
            case "clear", _:
                rig.send(Clearance(rig.last(Question).question + (len(words) and int(words[0])), said or None))
            case "quit", []:
                rig.do(Quit())
            case "planner", ["gone"]:
                rig.leave() if self.boards else rig.gone()
            case "planner", ["silent"]:
                rig.alive = False
            case "planner", ["speaks"]:
                rig.alive = True
            case (("planner" | "other" | "operator"), ["connects"]):
                rig.connect(CLIENTS[verb], "operator" if verb == "operator" else "planner")
            case (("other" | "operator"), ["gone"]):
                rig.gone(CLIENTS[verb])
            case "frame", []:
                rig.do(CAN)
            case "SYNC", ["leaves"]:
                rig.master.leave(rig.now)
                rig.do(CAN)
            case "fault", [code, source]:
                rig.master.fail(ArmFault(code, source, said))
            case "second", ["board", "starts", "anew"]:
                rig.master.boards[1].boots += 1
            case "SYNC", ["is", "lost"]:
                rig.master.switching.under_way = False
            case "lost", _:
                rig.master.fail(LOST, lost=states_of(words[0]) if words else 0)
            case "broken", _:
                rig.master.broken = set(words)
            case "inputs", ["on", lines]:
                rig.master.inputs.levels |= states_of(lines)
            case "inputs", ["off", lines]:
                rig.master.inputs.levels &= ~states_of(lines)
            case "master", [name, value]:
                part, _, mask = MASKS.get(name, name).rpartition(".")
                setattr(getattr(rig.master, part) if part else rig.master, mask, states_of(value))
            case "locked", ["actuator", "loose"]:  # it is where no plan knows: extended, with its output off
                rig.core.locked.change(0, 1)
                rig.core.locked.states = 0
                rig.master.inputs.levels = 0b10
                rig.core.motion.supervision.accept(0b10, ALL)
            case "supply", ["silent"]:
                rig.master.silent["supply"] = said
            case "board", [board, "is", "deaf"]:
                self.hears = rig.boards.board(board).pdos.receive
                rig.boards.board(board).pdos.receive = lambda cob_id, data, now: False
            case "board", [board, "hears"]:
                rig.boards.board(board).pdos.receive = self.hears
            case "executor", ["restarts"]:
                rig.executor.kill()
                rig.ended = False
                rig.executor.start()
                rig.connect()
            case "board", _:
                rig.fault(*words)
            case "bus", [verb]:
                getattr(rig.buses["can0"], {"down": "go_down", "off": "go_off", "on": "restore"}[verb])()
            case _:
                raise ValueError(f"no step: {step}")

    def _program(self, words: list[str]) -> tuple[list[int], dict[str, Any]]:
        """Reads states, stages "STATES@AT#MARK", and fields."""
        states, stages, fields = list[int](), list[Stage](), dict[str, Any]()
        rest = iter(words)
        for word in rest:
            if word in ("start", "homed"):
                fields[word] = states_of(next(rest))
            elif word in ("number", "epoch"):
                fields[word] = int(next(rest))
            elif word in ("step", "lasting"):
                fields[word] = float(next(rest))
            elif word in ("begin", "until"):
                fields[word] = self.rig.now + float(next(rest))
            elif word == "strict":
                fields["strict"] = True
            elif word == "open":
                fields["final"] = False
            elif "@" in word:
                bits, at, mark = re.fullmatch(r"(.+)@([-.\d]+)#?(\d*)", word).groups()  # type: ignore[union-attr]
                settled = float(at) + TRAVEL + TICK
                stages.append(Stage(pack(states_of(bits), SIZE), float(at), int(mark or -1), settled))
            else:
                states.append(states_of(word))
        return states, {**fields, **({"stages": tuple(stages)} if stages else {})}

    # --- what is seen

    def _compare(self, seen: list[str], ended: bool) -> None:
        told: dict[str, str] = {"switch": "", "declined": "", "mode": self.mode}
        results = []
        for part in seen:
            name, _, value = part.partition(" ")
            if part in MODES:
                told["mode"] = part
            elif name in STATUSES:
                results.append((int(value), name))
            elif part not in ("ended", "not taken"):
                told[name] = value
        rig = self.rig
        assert [(e.program, e.status) for e in self.new(Ended)] == results
        assert rig.ended == ended if self.boards else rig.core.ended == ended
        assert all(message.accepted != ("not taken" in seen) for message in self.new(Replaced))
        for name, value in told.items():
            found = FACTS[name](self)
            if isinstance(found, list):
                found = " ".join(map(str, found))
            if isinstance(found, int):
                known = states_of(value) if name in STATES else int(value)
                assert found == known, f"{name}: {found:b} or {found}"
            elif name == "apart":
                assert float(found) >= float(value), f"{name}: {found}"
            elif name == "switch":
                assert [states_of(word) for word in found.split()] == [states_of(word) for word in value.split()], found
            else:
                assert matches(found, value), f"{name}: {found}"

    def new(self, kind: type, client: Any = PLANNER) -> list[Any]:
        """Messages of this step."""
        heard = self.rig.heard[self.heard :]
        return [said for _, to, said in heard if isinstance(said, kind) and client in (None, to)]

    @property
    def switched(self) -> list[int]:
        return [] if self.boards else self.rig.switched

    @property
    def booted_so_far(self) -> int:
        return 0 if self.boards else self.rig.master.booted

    def switches(self) -> list[str]:
        """Commanded states of this step; on boards those at its end, if they differ."""
        if self.boards:
            return [f"{self.rig.driven:b}"] if self.rig.driven != self.driven else []
        return [f"{states % (1 << SIZE):b}/{states >> SIZE:b}" for states in self.switched[self.commits :]]

    def answers(self, accepted: bool) -> str:
        return " & ".join(answer.message for answer in self.new(Answer, None) if answer.accepted == accepted)

    def apart(self) -> str:
        """The least time between two commits, rounded down to periods [s]."""
        return f"{min(round(b - a, 2) for (a, _), (b, _) in pairwise(self.rig.master.commits)):g}"


def pulses(play: Play) -> list[str]:
    """Lengths of the first actuator's pulses [s]."""
    times = [at for at, mask in play.rig.master.left if mask & (1 | 1 << SIZE)]
    return [f"{off - on:.2f}" for on, off in zip(times[::2], times[1::2], strict=True)]


STATES: dict[str, Callable[[Play], int]] = {
    "outputs": lambda play: play.rig.master.outputs.commanded,
    "states": lambda play: play.rig.states,
    "measured": lambda play: unpack(play.rig.snapshot.measured),
    "known": lambda play: unpack(play.rig.snapshot.known),
    "homing": lambda play: unpack(play.rig.snapshot.homing),
    "locked": lambda play: unpack(play.rig.snapshot.locked),
    "unread": lambda play: unpack(play.rig.snapshot.unread),
    "coils": lambda play: sum(any(pair) << k for k, pair in enumerate(play.rig.boards.coils())),
    "positions": lambda play: play.rig.positions,
}
FACTS: dict[str, Callable[[Play], Any]] = {
    **STATES,
    "mode": lambda play: play.rig.mode,
    "switch": Play.switches,
    "declined": lambda play: [message.refused.reason.value for message in play.new(Declined)],
    "answer": lambda play: play.answers(True),
    "refused": lambda play: play.answers(False),
    "answers": lambda play: len(play.new(Answer, None)),
    "goodbye": lambda play: [message.reason for message in play.new(Goodbye, None)],
    "reason": lambda play: play.rig.reason,
    "message": lambda play: play.new(Ended)[-1].message,
    "switches": lambda play: play.new(Ended)[-1].switches,
    "verified": lambda play: "yes" if play.new(Ended)[-1].verified else "no",
    "changes": lambda play: [f"{change.line}{'-+'[change.level]}" for change in play.new(Ended)[-1].changes],
    "faults": lambda play: " & ".join(f"{code} {source}" for code, source in play.rig.faults) or "none",
    "marks": lambda play: [message.mark for message in play.new(Settled)],
    "counted": lambda play: [message.switches for message in play.new(Settled)],
    "stages": lambda play: [message.stages for message in play.new(Settled)],
    "planned": lambda play: ["yes" if message.planned else "no" for message in play.new(Settled)],
    "begun": lambda play: [message.stage for message in play.new(Begun)],
    "questions": lambda play: len(play.new(Question)),
    "question": lambda play: [f"{unpack(m.start):b} {unpack(m.stage):b}" for m in play.new(Question)],
    "counts": lambda play: play.rig.journal.counts,
    "epochs": lambda play: play.rig.epoch,
    "moving": lambda play: "yes" if play.rig.core.motion.moving else "no",
    "boots": lambda play: play.rig.master.booted - play.booted,
    "asked": lambda play: sorted({board for board, _ in play.rig.master.questions}),
    "apart": Play.apart,
    "at": lambda play: [f"{at - play.at:.2f}" for at, _ in play.rig.master.commits[play.commits :]],
    "pulses": pulses,
    "syncs": lambda play: len(play.rig.syncs),
    "log": lambda play: play.rig.logged[-1][1],
}
