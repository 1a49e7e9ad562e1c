"""Clients of the daemon: they ask for motion, stop, change obstacles, follow moving goals, repeat and vanish."""

from __future__ import annotations

import json
from random import Random
from typing import TYPE_CHECKING, Any

import numpy as np

from controller.planning.core.events import Key, refused
from controller.planning.planner import RequestDecoder
from controller.program import unpack
from controller.refusals.refusal import Refusal
from tests.simulation.whole.configurations import first_touched

if TYPE_CHECKING:
    from tests.simulation.whole.daemon import Daemon

ACTS = {
    **{"goal": 40, "jog": 8, "plan": 4, "cancel": 3, "cancel goal": 4, "stop": 1.5, "reset": 3, "degrade": 3},
    **{"obstacles": 6, "arm": 2, "stream": 6, "tip": 4, "garbage": 2, "repeat": 3, "many goals": 0.5, "wait": 10},
}
LATENCY = 0.005  # [s], longest delay of the network
MOTION = 0.15  # [s], mean time between a motion and its obstacles
STATES = ("contracted", "extended")


class Clients:
    """All clients.

    Attributes:
        calm: they only do what makes the arm ready.

    Args:
        daemon: whose clients they are.
        random: for requests and times.
    """

    def __init__(self, daemon: Daemon, random: Random) -> None:
        self.calm = False
        self._daemon, self._agenda, self._random = daemon, daemon.agenda, random
        self._decoder = RequestDecoder(daemon.arm)
        self._labels, self._dimension = daemon.executed.actuators, daemon.arm.manipulator.dimension
        self._numbers, self._last = 0, ("arm", b"")
        self._setpoint: bytes | None = None
        self._tip: bytes | None = None
        self._streams_until = 0.0
        self._rate = random.choice([2.0, 10.0, 20.0])
        self._crowd = random.choice([0.0, 0.4, 0.8])  # share of the motions to which obstacles come
        self._agenda.after(1.0, self._act)

    # --- the network

    def ask(self, key: Key, payload: dict[str, Any] | bytes = b"{}") -> None:
        """Sends a request, which arrives after a while; perhaps its client vanishes before the answer comes."""
        data = payload if isinstance(payload, bytes) else json.dumps(payload).encode()
        self._last = key, data
        self._agenda.after(self._random.uniform(0.0, LATENCY), lambda: self._arrive(key, data))

    def _arrive(self, key: Key, data: bytes) -> None:
        """Does what the gateway does with a request; without a planner nobody answers."""
        process, history = self._daemon.process, self._daemon.history
        if process is None or not self._daemon.awake:
            return
        asked = history.asks(process, key)
        try:
            asked.message = self._decoder.decode(key, data)
        except Refusal as refusal:
            asked.payload = dict(refused(refusal))
            return
        history.posted(asked)
        number = process.request(key, asked.message, asked.reply)
        if key in ("goal", "jog"):
            given = f"p{process.number}-{number:x}"
            history.named(asked, f"jog-{given}" if key == "jog" else asked.message.id or given)

    def setpoint(self) -> bytes | None:
        """Returns the latest set-point once."""
        payload, self._setpoint = self._setpoint, None
        return payload

    def tip(self) -> bytes | None:
        """Returns the latest measured tip once."""
        payload, self._tip = self._tip, None
        return payload

    # --- what they do

    def _act(self) -> None:
        if self.calm:
            self._make_ready()
            self._agenda.after(0.2, self._act)
            return
        act, state = self._random.choices(list(ACTS), list(ACTS.values()))[0], self._daemon.history.state
        if state is not None and state["mode"] in ("fault", "stopped") and self._random.random() < 0.3:
            act = "reset"
        match act:
            case "goal":
                self.ask("goal", self.goal())
                self._crowd_in(1)
            case "plan":
                self.ask("plan", self.goal())
            case "jog":
                self.ask("jog", {"actuators": self._some_states()})
                self._crowd_in(1)
            case "cancel" | "stop" | "reset" | "arm":
                self.ask(act)
            case "cancel goal":
                back = self._random.choice([0, 0, 0, 1, 2])
                self.ask("cancel", {"id": f"g{max(self._numbers - back, 0)}"})
            case "degrade":
                label = self._random.choice([*self._labels, self._labels[0], "9.9"])
                self.ask("degrade", {"actuator": label, "state": self._random.choice([None, None, 0, 1])})
            case "obstacles":
                self.ask("obstacles", {"regions": self._regions()})
            case "stream":
                self._streams_until = self._agenda.now + self._random.uniform(0.1, 3.0)
                self._stream(self._random.choice([0.01, 0.03, 0.2]))
                self._crowd_in(3)
            case "tip":
                self._measure()
            case "garbage":
                key = self._random.choice(["goal", "jog", "plan", "cancel", "degrade", "obstacles", "stop"])
                self.ask(key, self._random.choice([b"", b"\xff", b"[1]", b'{"waypoints": []}', b'{"id": 5}']))
            case "repeat":
                self.ask(*self._last)  # type: ignore[arg-type]
            case "many goals":
                for _ in range(20):
                    self.ask("goal", self.goal())
        self._agenda.after(self._random.expovariate(self._rate), self._act)

    def _crowd_in(self, times: int) -> None:
        """Sends obstacles soon, perhaps: they come while a motion is planned, offered, under way or replaced."""
        random = self._random
        for _ in range(times if random.random() < self._crowd else 0):
            self._agenda.after(random.expovariate(1 / MOTION), self._change_obstacles)

    def _change_obstacles(self) -> None:
        if not self.calm:
            self.ask("obstacles", {"regions": self._regions()})

    def goal(self) -> dict[str, Any]:
        """Returns a goal of 1 to 5 waypoints, few of which cannot be reached."""
        random, pace = self._random, self._daemon.pace
        self._numbers += 1
        time, waypoints = random.choice([0.0, 0.0, 0.5]), list[dict[str, Any]]()
        for _ in range(random.choice([1, 1, 2, 3, 5])):
            waypoints.append({"position": self.position(0.02), "t": time})
            if random.random() < 0.15:
                row = random.choice(self._daemon.space.notations)
                waypoints[-1] = {"configuration": row, "t": time}
            time += pace.shortest * random.choice([1.0, 2.0, 4.0, len(self._labels)])
        message: dict[str, Any] = {"waypoints": waypoints}
        if random.random() < 0.9:
            message["id"] = f"g{self._numbers}"
        if random.random() < 0.15:
            message["stamp"] = self._daemon.wall() + random.uniform(-0.5, 1.0)
        if random.random() < 0.5:
            message["tolerance"] = {"position": random.choice([0.05, 0.3, 1.0])}
        return message

    def simple_goal(self) -> dict[str, Any]:
        """Returns a goal that the arm can reach with its locked actuators."""
        self._numbers += 1
        tip = self._daemon.space.tips[self._random.choice(self._free())]
        return {"id": f"g{self._numbers}", "waypoints": [{"position": [float(x) for x in tip]}]}

    def _free(self) -> list[int]:
        """Returns the configurations with the present locks that touch no obstacle."""
        locked, states, cubes = 0, 0, self._daemon.history.cubes
        if self._daemon.snapshot is not None:
            locked, states = unpack(self._daemon.snapshot.locked), unpack(self._daemon.snapshot.measured)
        codes = ((code, k) for code, k in self._daemon.space.index.items() if not (code ^ states) & locked)
        return [k for code, k in codes if first_touched(cubes, code, [code]) is None]

    def position(self, unreachable: float = 0.0) -> list[float]:
        """Returns the tip of a random configuration, or a position that perhaps no configuration reaches.

        Most tips are those of configurations with the present locks that touch no obstacle.
        """
        tips = self._daemon.space.tips
        free = self._free() if self._random.random() < 0.7 else []
        tip = tips[self._random.choice(free or range(len(tips)))]
        if self._random.random() < unreachable:
            tip = tip * 0.9
        return [float(x) for x in tip]

    def _some_states(self) -> dict[str, str]:
        count = self._random.choice([1, 1, 2, len(self._labels)])
        return {label: self._random.choice(STATES) for label in self._random.sample(self._labels, count)}

    def _regions(self) -> list[dict[str, Any]]:
        """Returns obstacles, each a cube of states; most do not touch the arm at rest."""
        random, size, regions = self._random, len(self._labels), list[dict[str, Any]]()
        for k in range(random.choice([0, 1, 1, 2, 4])):
            mask = sum(1 << bit for bit in random.sample(range(size), min(size, random.choice([2, 3, 4]))))
            value = random.getrandbits(size) & mask
            if self._daemon.snapshot is not None and random.random() < 0.9:
                measured = unpack(self._daemon.snapshot.measured) & mask
                value = measured ^ mask & -mask if value == measured else value
            regions.append({"disc": {"centre": [mask, value], "radius": 1.0}, "name": f"cube{k}"})
        return regions

    def _stream(self, period: float) -> None:
        """Sends set-points along a line until the stream ends."""
        random, first, last = self._random, np.array(self.position()), np.array(self.position())
        began, duration = self._agenda.now, random.uniform(0.1, 2.0)

        def step() -> None:
            if self._agenda.now > self._streams_until or self.calm:
                return
            share = min((self._agenda.now - began) / duration, 1.0)
            position = (first + share * (last - first)).tolist()
            stamp = self._daemon.wall() - random.choice([0.0, 0.0, 0.3]) if random.random() < 0.5 else 0.0
            tolerance = {"position": random.choice([0.01, 0.3])}
            self._setpoint = json.dumps({"position": position, "stamp": stamp, "tolerance": tolerance}).encode()
            self._daemon.history.setpoint_at = self._agenda.now
            self._agenda.after(period, step)

        step()

    def _measure(self) -> None:
        tip = [x + self._random.gauss(0.0, 1e-5) for x in self.position()]
        if self._daemon.snapshot is not None:
            code = unpack(self._daemon.snapshot.measured)
            tip = [float(x) for x in self._daemon.space.tips[self._daemon.space.index.get(code, 0)]]
        stamp = self._daemon.wall() - self._random.choice([0.0, 0.001, 2.0])
        self._tip = json.dumps({"position": tip, "stamp": stamp}).encode()

    def _make_ready(self) -> None:
        """Asks for what is needed so that the arm takes a goal."""
        state, snapshot, daemon = self._daemon.history.state, self._daemon.snapshot, self._daemon
        if snapshot is None or state is None or daemon.process is None or daemon.history.waits("reset", "degrade"):
            return
        free = unpack(snapshot.locked) & ~daemon.executed.locked
        if daemon.history.cubes and not daemon.history.waits("obstacles"):
            self.ask("obstacles", {"regions": []})
        if state["mode"] in ("fault", "stopped"):
            self.ask("reset")
        elif state["mode"] == "executing" and not daemon.wanted:
            self.ask("cancel")
        elif state["mode"] == "ready" and free:
            self.ask("degrade", {"actuator": self._labels[(free & -free).bit_length() - 1], "state": None})
        elif unpack(snapshot.measured) not in daemon.space.index and not daemon.history.waits("jog"):
            locked = unpack(snapshot.locked)
            labels = [label for k, label in enumerate(self._labels) if not locked >> k & 1]
            code = daemon.space.nearest(unpack(snapshot.measured), locked)
            states = {label: STATES[code >> self._labels.index(label) & 1] for label in labels}
            self.ask("jog", {"actuators": states})
