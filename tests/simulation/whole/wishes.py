"""What clients ask for: goals, jogs, obstacles and poses, drawn for the arm as it is."""

from __future__ import annotations

import math
from random import Random
from typing import TYPE_CHECKING, Any

from hyperbit.controller.program import unpack
from tests.simulation.judge.interface.locks import leaves_states
from tests.simulation.whole.configurations import first_touched

if TYPE_CHECKING:
    from tests.simulation.whole.daemon import Daemon

STATES = ("contracted", "extended")
POSES = ("pick", "place", "a b", "P1")


class Wishes:
    """Draws what clients ask for."""

    def __init__(self, daemon: Daemon, random: Random) -> None:
        self.numbers = 0
        self._daemon, self._random, self._labels = daemon, random, daemon.executed.actuators

    def goal(self) -> dict[str, Any]:
        """Returns a goal of 1 to 5 waypoints, few of which cannot be reached."""
        random, pace = self._random, self._daemon.pace
        self.numbers += 1
        time, waypoints = random.choice([0.0, 0.0, 0.5]), list[dict[str, Any]]()
        for _ in range(random.choice([1, 1, 2, 3, 5])):
            waypoints.append({"position": self.position(0.02), "t": time})
            if random.random() < 0.15:
                row = random.choice(self._daemon.space.notations)
                waypoints[-1] = {"configuration": row, "t": time}
            time += pace.shortest * random.choice([1.0, 2.0, 4.0, len(self._labels)])
        message: dict[str, Any] = {"waypoints": waypoints}
        if random.random() < 0.12:
            self._follow_lines(message)
        elif random.random() < 0.25:
            self._turn(message)
        if random.random() < 0.9 or "path_tolerance" in message:
            message["id"] = f"g{self.numbers}"
        if random.random() < 0.15:
            message["stamp"] = self._daemon.wall() + random.uniform(-0.5, 1.0)
        if random.random() < 0.5:
            chosen = {"position": random.choice([0.05, 0.3, 1.0])}
            message["tolerance"] = {**message.get("tolerance", {}), **chosen}
        if random.random() < 0.1:
            message["deadline"] = random.choice([0.1, 1.0, 5.0])
        if random.random() < 0.2:
            message["begin_within"] = random.choice([0.2, 1.0, 5.0])
        return message

    def _turn(self, message: dict[str, Any]) -> None:
        """Asks for orientations at some positions: mostly those of configurations."""
        random, space = self._random, self._daemon.space
        for waypoint in message["waypoints"]:
            if "position" in waypoint and random.random() < 0.6:
                k = random.choice(self._free() or range(len(space.tips)))
                waypoint["position"] = [float(x) for x in space.tips[k]]
                waypoint["orientation"] = float(space.angles[k]) + random.choice([0.0, 0.0, 0.02, 2 * math.pi])
        message["tolerance"] = {"orientation": random.choice([0.05, 0.5, 4.0])}

    def _follow_lines(self, message: dict[str, Any]) -> None:
        """Asks for straight lines between positions, mostly slow enough."""
        random, waypoints = self._random, message["waypoints"]
        tolerance, time = random.choice([0.4, 1.0]), 0.0
        for k, waypoint in enumerate(waypoints):
            if random.random() < 0.95:
                waypoint.pop("configuration", None)
                waypoint.setdefault("position", self.position())
            if k and "position" in waypoint and "position" in waypoints[k - 1]:
                length = math.dist(waypoint["position"], waypoints[k - 1]["position"])
                parts = math.ceil(length / (tolerance / 2)) + 1
                time += self._daemon.pace.shortest * parts * random.choice([1.0, 1.0, 2.0, 0.3])
            elif k:
                time += self._daemon.pace.shortest
            waypoint["t"] = time
        message["path_tolerance"] = tolerance

    def simple_goal(self) -> dict[str, Any]:
        """Returns a goal that the arm can reach with its locked actuators."""
        self.numbers += 1
        tips = self._daemon.space.tips
        tip = tips[self._random.choice(self._free() or range(len(tips)))]
        return {"id": f"g{self.numbers}", "waypoints": [{"position": [float(x) for x in tip]}]}

    def _free(self) -> list[int]:
        """Returns the configurations with the present locks that touch no obstacle."""
        locked, states, cubes = 0, 0, self._daemon.judge.account.cubes
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

    def some_states(self) -> dict[str, str]:
        count = self._random.choice([1, 1, 2, len(self._labels)])
        return {label: self._random.choice(STATES) for label in self._random.sample(self._labels, count)}

    def lock(self) -> dict[str, Any]:
        """Returns a lock; some leave a module without state, and no end-stop contradicts them."""
        random, snapshot = self._random, self._daemon.snapshot
        label, state = random.choice([*self._labels, self._labels[0], "9.9"]), random.choice([None, None, 0, 1])
        if snapshot is not None and random.random() < 0.3:
            contradicted = unpack(snapshot.sensed) & unpack(snapshot.known)
            every = [(k, value) for k in range(len(self._labels)) for value in (0, 1)]
            every = [(k, v) for k, v in every if not contradicted & (unpack(snapshot.measured) ^ v << k) >> k & 1]
            modules = self._daemon.judge.account.modules
            bad = [(self._labels[k], value) for k, value in every if not leaves_states(modules, snapshot, k, value)]
            label, state = random.choice(bad or [(label, state)])
        return {"actuator": label, "state": state}

    def regions(self) -> list[dict[str, Any]]:
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

    def pose(self) -> dict[str, Any]:
        """Returns a request on poses; a few are malformed."""
        random = self._random
        name = random.choice([*POSES, "home"]) if random.random() < 0.9 else random.choice(["", " a", "x" * 41, "a/b"])
        goal = {key: value for key, value in self.simple_goal().items() if key != "id"}
        goal |= random.choice([{}] * 8 + [{"id": "p"}, {"stamp": 5.0}, {"waypoints": []}])
        message = random.choice([{"save": name, "goal": goal}] * 4 + [{"remove": name}] * 4)
        return message if random.random() < 0.9 else random.choice([{"save": name}, {"goal": goal}, {}, {"remove": 5}])
