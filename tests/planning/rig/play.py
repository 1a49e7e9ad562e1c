"""Plays scenarios on a desk: the planner's core, with clients and an executor that the test plays.

What the core says to clients and to the executor is told in its order, and nothing else is said, but feedback,
acknowledgements, and replacements of look-ahead, which may be told. Facts are compared where they are told.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hyperbit.controller.planning.core import tasks
from hyperbit.controller.planning.core.events import AcceptanceEntry, Identity, ResultEntry, Unsent, Warned
from hyperbit.controller.program import (
    Acknowledge,
    Cancel,
    Clearance,
    Down,
    Fault,
    Lock,
    PlayFault,
    Program,
    Replaced,
    Replacement,
    Reset,
    Setpoint,
    Stop,
)
from tests.planning.rig import executor_steps
from tests.planning.rig.desk import Desk
from tests.planning.rig.facts import FACTS
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
        self.setpoint: Any = None  # the latest command of a stream
        self.commanded, self._followed = False, ""  # whether one came in this step; what was told of the latest

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
            case "setpoint", [at, *rest]:
                fields = dict(zip(rest[::2], rest[1::2], strict=True))
                stamp = {"stamp": desk.wall - float(fields["old"])} if "old" in fields else {}
                desk.setpoint({"position": self._place(at), **stamp}, fields.get("from", ""))
            case "setpoint", []:
                desk.setpoint(said.encode())
            case "stream", [at, "for", seconds, *sender]:
                desk.stream(self._place(at), float(seconds), *sender[1:])
            case "clock", [seconds]:
                desk.wall += float(seconds)
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
                executor_steps.do(self, did, rest, said)
            case "unsent", []:
                desk.post(Unsent(self.asked.request, said))
            case _:
                raise ValueError(f"no step: {step}")

    def _begin_anew(self, knows: list[str], message: str) -> None:
        """Goes on with another planner process of the same arm, which finds that it owes a result or has told it."""
        instance, identity = self.executor.instance, Identity(1, self.program.program)
        outcome = ("succeeded", 0) if message.startswith("reached") else ("aborted", -4)
        told = ResultEntry(0.0, *outcome, message, 3)
        self.desk = Desk(
            self.desk.arm,
            self.desk.densities,
            published={identity: told} if "told" in knows else {},
            owed={identity: AcceptanceEntry("a", 12.0, 1)} if "owes" in knows else {},
        )
        self.executor = self.desk.executor
        self.executor.instance = instance
        self.executor.greet()

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
        return [(self._place(at), float(radius)) for at, radius in zip(words[::2], words[1::2], strict=True)]

    def _place(self, name: str) -> list[float]:
        return FAR if name == "far" else self.desk.tip(*NAMED[name])

    def packed(self, name: str) -> bytes:
        return self.desk.packed(*NAMED[name])

    # --- what is said

    def _said(self) -> list[str]:
        told = list[str]()
        self.commanded = False
        while self.desk.said:  # the answer to a message may have the core say more
            key, what = self.desk.said.pop(0)
            self.payload = self.payload if key == "executor" else what
            if isinstance(what, Setpoint):
                text = self._command(what)
                if text == self._followed and self.setpoint.stream == what.stream:
                    text = ""  # a command is repeated all the time
                self.setpoint, self.commanded, self._followed = what, True, text or self._followed
            else:
                text = self._told(key, what)
            told += [text] if text else []
        return told

    def _command(self, message: Setpoint) -> str:
        words = "follow" if message.stages else "hold"
        return f"{words}{' strict' if message.strict else ''}{message.reason.removeprefix('following a setpoint')}"

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
