"""Plays scenarios on a desk: the planner's core, with clients and an executor that the test plays.

What the core says to clients and to the executor is told in its order, and nothing else is said, but feedback,
acknowledgements, and replacements of look-ahead, which may be told. Facts are compared where they are told.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hyperbit.controller.planning.core import tasks
from hyperbit.controller.planning.core.events import AcceptanceEntry, Identity, ResultEntry, Unsent, Warned
from hyperbit.controller.program import (
    Acknowledge,
    Answer,
    Cancel,
    Clearance,
    Down,
    Fault,
    Lock,
    PlayFault,
    Program,
    Question,
    Replaced,
    Replacement,
    Reset,
    Stop,
    Travel,
    pack,
    unpack,
)
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refused
from tests.planning.rig.desk import Desk
from tests.scenario import Scenario, matches

NAMED = {
    "A": (1, 2, 0, 0), "B": (3, 4, 0, 1), "C": (7, 0, 2, 0), "HOME": (0, 0, 0, 0), "NEAR": (0, 1, 0, 0),
    "AWAY": (3, 3, 3, 3), "UP": (0, 0, 0, 1), "LAST": (0, 0, 0, 7),
}  # fmt: skip
OPTIONAL = ("feedback", "acknowledge", "stages")  # of these, those that are not told may be said, too
FAR = [5.0, 5.0]


class Play:
    def __init__(self, scenario: Scenario, desk: Desk) -> None:
        self.scenario, self.desk = scenario, desk
        self.executor = desk.executor
        self.program: Any = None  # the latest one that was offered, and accepted
        self.running: Any = None
        self.ended: Any = None  # the latest result of the executor
        self.asked: Any = None  # the latest request that waits for the executor's answer
        self.replaced: Any = None
        self.questions = 0
        self.began, self.payload = desk.now, dict[str, Any]()

    def run(self, path: Path) -> None:
        for line in self.scenario.lines:
            try:
                self._step(line.step)
                self._compare(self._said(), line.seen)
            except Exception as error:
                error.add_note(f"{path}:{line.number}: {line.step} -> {' | '.join(line.seen)}")
                raise

    # --- what clients and the executor do

    def _step(self, step: str) -> None:
        desk = self.desk
        text, _, said = step.partition(": ")
        verb, *words = text.split()
        match verb, words:
            case "goal", [name, *rest]:
                configurations, fields = self._goal(rest)
                desk.ask("goal", {"id": name, **self._waypoints(configurations, fields), **fields}, "goal")
            case "plan", [name, *rest]:
                configurations, fields = self._goal(rest)
                desk.ask("plan", {"id": name, **self._waypoints(configurations, fields), **fields}, "plan")
            case "ask", [key]:
                desk.ask(key, said.encode(), key)
            case "cancel", _:
                desk.ask("cancel", {"id": words[0]} if words else None, "cancel")
            case (("stop" | "reset"), []):
                desk.ask(verb, None, verb)
            case "jog", _:
                desk.ask("jog", {"actuators": dict(zip(words[::2], words[1::2], strict=True))}, "jog")
            case "degrade", [actuator, state]:
                desk.ask("degrade", {"actuator": actuator, "state": None if state == "free" else int(state)}, "degrade")
            case "obstacles", _:
                discs = [{"centre": centre, "radius": radius} for centre, radius in self._discs(words)]
                regions = [{"disc": disc, "name": f"d{k}"} for k, disc in enumerate(discs)]
                desk.ask("obstacles", {"regions": regions}, "obstacles")
            case "arm", []:
                desk.ask("arm", None, "arm")
            case "wait", [seconds]:
                desk.pass_time(float(seconds))
            case "delay", [seconds]:
                desk.delay = float(seconds)
            case "quit", []:
                desk.quit()
            case "hold", _:
                desk.held |= {getattr(tasks, word) for word in words}
            case "release", _:
                desk.release(*(getattr(tasks, word) for word in words))
            case "fail", _:
                desk.failing = {getattr(tasks, word) for word in words}
            case "ledger", ["waits"]:
                desk.storing = False
            case "ledger", ["stores"]:
                desk.store()
            case "warning", [code, source]:
                desk.post(Warned((Fault(code, source, said),)))
            case "warnings", ["over"]:
                desk.post(Warned(()))
            case "another", ["process", *knows]:
                self._begin_anew(knows, said)
            case "executor", [did, *rest]:
                self._executor(did, rest, said)
            case "unsent", []:
                desk.post(Unsent(self.asked.request, said))
            case _:
                raise ValueError(f"no step: {step}")

    def _begin_anew(self, knows: list[str], message: str) -> None:
        """Goes on with another planner process of the same arm, which finds that it owes a result or has told it."""
        instance, identity = self.executor.instance, Identity(1, self.program.program)
        told = ResultEntry(0.0, "aborted", -4, message, 3)
        self.desk = Desk(
            self.desk.arm,
            self.desk.densities,
            published={identity: told} if "told" in knows else {},
            owed={identity: AcceptanceEntry("a", 12.0, 1)} if "owes" in knows else {},
        )
        self.executor = self.desk.executor
        self.executor.instance = instance
        self.executor.greet()

    def _executor(self, did: str, words: list[str], said: str) -> None:
        executor, given = self.executor, dict(zip(words[::2], words[1::2], strict=False))
        match did:
            case "accepts":
                self.running = self.program
                executor.accept(self.program)
            case "declines":
                facts = {words[1]: said} if len(words) > 1 else {}
                executor.decline(self.program, Reason(words[0]), **facts)
            case "runs":
                stage, switches = (
                    int(words[0]),
                    int(dict(zip(words[1::2], words[2::2], strict=True)).get("switches", 1)),
                )
                measured = dict(zip(words[1::2], words[2::2], strict=True)).get("at")
                executor.run(self.running, stage, switches, measured and self.desk.packed(*NAMED[measured]))
            case "ends":
                program = self.running or self.program
                status = words[0] if len(words) % 2 else "done"
                fields = dict(zip(words[len(words) % 2 :: 2], words[len(words) % 2 + 1 :: 2], strict=True))
                more: dict[str, Any] = {name: int(fields[name]) for name in ("mark", "switches") if name in fields}
                more |= {"verified": False} if "verified" in fields else {}
                if "travels" in fields:
                    more["travels"] = (Travel(5, 1, float(fields["travels"])),)
                if "at" in fields:
                    more["measured"] = self.desk.packed(*NAMED[fields["at"]])
                if status == "done":
                    more.setdefault("mark", program.stages[-1].mark)
                else:
                    more.setdefault("mark", -1)
                self.ended = executor.end(program, status, said or "done", **more)
            case "repeats":
                executor.send(self.ended)
            case "answers" | "refuses":
                executor.answer(self.asked, said, did == "answers", **self._fields(given))
            case "locked":  # a refusal of a lock, without a new epoch
                refused = Refused(Reason.LOCK_WHILE_MOVING, {"mode": "executing"})
                executor.send(Answer(self.asked.request, "", refused))
            case "shows":
                self.desk.show(**self._fields(given))
            case "replaces":
                executor.send(Replaced(self.running.program, self.replaced.generation, True))
            case "asks":
                self.questions += 1
                start, stage = (self.desk.packed(*NAMED[word]) for word in words)
                executor.send(Question(self.questions, start, stage))
            case "dies":
                self.desk.drop(said or "the executor closed the connection")
            case "greets":
                executor.greet(self.program.program if self.program else 0)
            case "tells":
                executor.send(Answer(self.asked.request, said))
            case "changes":
                executor.instance += 1
            case "restarts":
                executor.instance += 1
                executor.greet()
            case _:
                raise ValueError(f"the executor cannot: {did}")

    def _fields(self, given: dict[str, str]) -> dict[str, Any]:
        size = self.executor.actuators
        fields: dict[str, Any] = {}
        for name, word in given.items():
            if name in ("mode", "reason"):
                fields[name] = word
            elif name in ("locks", "epoch"):
                fields[name] = int(word)
            elif name == "moving":
                fields[name] = word == "yes"
            elif word in NAMED:
                fields[name] = self.desk.packed(*NAMED[word])
            elif word.startswith("all"):  # "all-11": all but those of a binary number
                fields[name] = pack(((1 << size) - 1) & ~int(word[4:] or "0", 2), size)
            else:
                fields[name] = pack(int(word, 2), size)
        return fields

    def _goal(self, words: list[str]) -> tuple[list[str], dict[str, Any]]:
        fields: dict[str, Any] = {}
        names = [word for word in words if word in NAMED or (word.isdigit() and len(word) == 4)]
        rest = [word for word in words if word not in names]
        for name, value in zip(rest[::2], rest[1::2], strict=True):
            fields[name] = float(value)
        if "tolerance" in fields:
            fields["tolerance"] = {"position": fields["tolerance"]}
        return names, fields

    def _waypoints(self, names: list[str], fields: dict[str, Any]) -> dict[str, Any]:
        step = fields.pop("step", 0.2)
        at = [{"position": self.desk.tip(*NAMED[name])} if name in NAMED else {"configuration": name} for name in names]
        return {"waypoints": [{"t": step * k, **where} for k, where in enumerate(at)]}

    def _discs(self, words: list[str]) -> list[tuple[list[float], float]]:
        return [
            (FAR, float(radius)) if at == "far" else (self.desk.tip(*NAMED[at]), float(radius))
            for at, radius in zip(words[::2], words[1::2], strict=True)
        ]

    # --- what is said

    def _said(self) -> list[str]:
        told = list[str]()
        while self.desk.said:  # the answer to a message may have the core say more
            key, what = self.desk.said.pop(0)
            self.payload = self.payload if key == "executor" else what
            told.append(self._told(key, what))
        return told

    def _told(self, key: str, what: Any) -> str:
        if key == "executor":
            return self._sent(what)
        if key == "feedback":
            return f"feedback {what['waypoint']}"
        if key in ("result", "inherited"):
            repeated = " again" if what.get("repeated") else ""
            return f"{key} {what['id']} {what['status']}{repeated}: {what['message']}"
        if key == "arm":
            return "arm"
        return f"{key} {'accepted' if what['accepted'] else what.get('reason', 'refused')}: {what['message']}"

    def _sent(self, message: Down) -> str:
        match message:
            case Program():
                self.program = message
                return f"program {message.name.removeprefix('goal ')}{' strict' if message.strict else ''}"
            case Replacement():
                self.replaced = message
                if not message.stages and not message.final:
                    self.executor.send(Replaced(message.program, message.generation, True))
                    return "park"
                return "strict stages" if message.strict else "stages"
            case Cancel():
                self.asked = message
                return f"cancel {'all' if message.program is None else self._name(message.program)}: {message.reason}"
            case Stop():
                self.asked = message
                return "stop"
            case Reset():
                self.asked = message
                return f"reset {message.epoch}"
            case Lock():
                self.asked = message
                return f"lock {message.actuator} {message.state}"
            case PlayFault():
                self.asked = message
                return f"fault {message.fault}"
            case Clearance():
                return f"clearance {message.question}: {message.touched or 'clear'}"
            case Acknowledge():
                assert self.ended is not None
                assert message.result == self.ended.result
                return "acknowledge"
            case _:
                return type(message).__name__

    def _name(self, number: int) -> str:
        return "it" if self.program is not None and number == self.program.program else str(number)

    def _compare(self, said: list[str], seen: list[str]) -> None:
        told = [part for part in seen if part.partition(" ")[0] not in FACTS]
        for text in said:
            if told and matches(text, told[0]):
                told.pop(0)
            else:
                assert text.partition(" ")[0] in OPTIONAL, f"said: {' | '.join(said)}"
        assert not told, f"said: {' | '.join(said)}"
        for part in seen:
            name, _, value = part.partition(" ")
            if name in FACTS:
                found = str(FACTS[name](self))
                assert matches(found, value), f"{name}: {found}"


def codes(play: Play) -> str:
    return " ".join(fault["code"] for fault in play.desk.state()["faults"]) or "none"


FACTS: dict[str, Callable[[Play], Any]] = {
    "mode": lambda play: play.desk.state()["mode"],
    "reason": lambda play: play.desk.state()["reason"],
    "faults": codes,
    "degraded": lambda play: " ".join(f"{it['actuator']} {it['state']}" for it in play.desk.state()["degraded"]),
    "homing": lambda play: " ".join(play.desk.state()["homing"]),
    "scene": lambda play: play.desk.state()["obstacles"],
    "entries": lambda play: " ".join(kind for kind, _ in play.desk.entries),
    "epoch": lambda play: play.program.epoch,
    "name": lambda play: play.program.name,
    "start": lambda play: f"{unpack(play.program.start):b}",
    "homed": lambda play: f"{unpack(play.program.homed):b}" if play.program.homed else "none",
    "until": lambda play: f"{play.program.until - play.began:g}",
    "last": lambda play: f"{unpack(play.program.stages[-1].states):b}",
    "first": lambda play: play.replaced.first,
    "failures": lambda play: len(play.desk.failures),
    "log": lambda play: "\n".join(play.desk.logs),
    "closed": lambda play: "yes" if play.desk.core.ended else "no",
    "hurried": lambda play: len(set(play.desk.hurried)),
    "payload": lambda play: json.dumps(play.payload),
}
