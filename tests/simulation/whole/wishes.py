"""What clients ask for: goals, jogs, obstacles and poses, drawn for the arm as it is."""

from __future__ import annotations

import math
from collections.abc import Sequence
from random import Random
from typing import TYPE_CHECKING, Any

import numpy as np

from hyperbit.controller.program import unpack
from tests.simulation.statements.asked import states_from
from tests.simulation.whole.configurations import Disc

if TYPE_CHECKING:
    from tests.simulation.whole.daemon import Daemon

MOST_TRIES = 5  # places of an obstacle, until one is clear of the arm
STATES = ("contracted", "extended")
NEAR = 2  # switches to a near configuration
WILLING = 0.9  # share of the goals that can be accepted if the arm is ready, and stays so
POSES = ("pick", "place", "a b", "P1")


class Wishes:
    """Draws what clients ask for."""

    def __init__(self, daemon: Daemon, random: Random) -> None:
        self.numbers, self._willing = 0, True
        self._daemon, self._random, self._labels = daemon, random, daemon.executed.actuators

    def goal(self) -> dict[str, Any]:
        """Returns a goal of 1 to 5 waypoints; most goals can be accepted if the arm is ready."""
        random, pace = self._random, self._daemon.pace
        self._willing = random.random() < WILLING
        self.numbers += 1
        time, waypoints = random.choice([0.0, 0.0, 0.5]), list[dict[str, Any]]()
        for _ in range(random.choice([1, 1, 1, 2, 2, 3, 5])):
            waypoints.append({"position": self.position(0.2), "t": time})
            if random.random() < 0.15:
                row = self._daemon.space.notations[random.choice(self._chosen())]
                waypoints[-1] = {"configuration": row, "t": time}
            enough = max(pace.needed(len(self._labels)), 3 * pace.shortest)
            time += enough if self._willing else pace.shortest * random.choice([1.0, 2.0, 4.0])
        message: dict[str, Any] = {"waypoints": waypoints}
        if random.random() < 0.12:
            self._follow_lines(message)
        elif random.random() < 0.25:
            self._turn(message)
        if random.random() < 0.9 or "path_tolerance" in message:
            message["id"] = f"g{self.numbers}"
        if random.random() < 0.15:
            message["stamp"] = self._daemon.wall() + random.uniform(0.6 if self._willing else -0.5, 1.0)
        if random.random() < 0.7:
            chosen = {"position": random.choice([0.05, 0.3, 1.0])}
            message["tolerance"] = {**message.get("tolerance", {}), **chosen}
            for waypoint in waypoints if "path_tolerance" not in message else ():
                self._shift(waypoint, chosen["position"])
        if random.random() < 0.1:
            message["deadline"] = random.choice([1.0, 5.0] if self._willing else [0.1, 1.0, 5.0])
        if random.random() < 0.2:
            message["begin_within"] = random.choice([1.0, 5.0] if self._willing else [0.2, 1.0, 5.0])
        return message

    def _shift(self, waypoint: dict[str, Any], tolerance: float) -> None:
        """Moves a position within the tolerance: into an obstacle, or in any direction."""
        random = self._random
        if "position" not in waypoint:
            return
        place, discs = waypoint["position"], sorted(self._daemon.exchange.possible)
        near = [[disc.x, disc.y] for disc in discs if math.dist(place, disc[:2]) < 0.95 * tolerance]
        if near and random.random() < 0.5:
            waypoint["position"] = random.choice(near)
        else:
            angle, by = random.uniform(-math.pi, math.pi), random.choice([0.0, 0.5, 0.95]) * tolerance
            waypoint["position"] = [place[0] + by * math.cos(angle), place[1] + by * math.sin(angle)]

    def _turn(self, message: dict[str, Any]) -> None:
        """Asks for orientations at some positions: mostly those of configurations."""
        random, space = self._random, self._daemon.space
        for waypoint in message["waypoints"]:
            if "position" in waypoint and random.random() < 0.6:
                k = random.choice(self._chosen())
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
                time += self._daemon.pace.shortest * parts * random.choice([2.0, 3.0] if self._willing else [1.0, 0.3])
            elif k:
                time += self._daemon.pace.shortest
            waypoint["t"] = time
        message["path_tolerance"] = tolerance

    def simple_goal(self) -> dict[str, Any]:
        """Returns a goal that the arm can reach with its locked actuators."""
        self.numbers += 1
        tips = self._daemon.space.tips
        tip = tips[self._random.choice(self._reachable() or range(len(tips)))]
        return {"id": f"g{self.numbers}", "waypoints": [{"position": [float(x) for x in tip]}]}

    def sure_goal(self) -> dict[str, Any]:
        """Returns a goal of up to four waypoints that succeeds in calm; several configurations may serve each."""
        tips, reachable, random = self._daemon.space.tips, self._reachable(), self._random
        apart = 1.1 * self._daemon.pace.needed(len(self._labels))
        places = [tips[random.choice(reachable)].tolist() for _ in range(random.choice([1, 2, 3]))]
        waypoints = [{"position": place, "t": k * apart} for k, place in enumerate(places)]
        tolerance = {"position": random.choice([0.05, 0.3, 1.0])}
        return {**self.simple_goal(), "waypoints": waypoints, "tolerance": tolerance}

    def drawn(self) -> tuple[str, dict[str, Any] | bytes, tuple[str, ...]]:
        """Returns key and payload of a request in calm, and its possible answers."""
        position, row, jogged = self.position(), self._daemon.space.notations[0], self.some_states()
        locked = {label for k, label in enumerate(self._labels) if self._daemon.executed.locked >> k & 1}
        asked = [
            ("goal", self.simple_goal(), ("accepted",)),
            ("plan", self.simple_goal(), ("accepted",)),
            ("jog", {"actuators": jogged}, ("actuator-locked" if locked & jogged.keys() else "accepted",)),
            ("cancel", {"id": "nobody"}, ("accepted",)),
            ("obstacles", {"regions": []}, ("accepted",)),
            ("reset", {}, ("accepted",)),
            ("goal", {"waypoints": []}, ("no-waypoints",)),
            ("goal", b"\xff", ("not-utf8",)),
            ("goal", b"{", ("not-json",)),
            ("goal", b"[1]", ("no-object",)),
            ("goal", {"waypoints": [{"t": 1.0}]}, ("no-destination",)),
            ("goal", {"waypoints": [{"position": [0.1, 0.1, 0.1]}]}, ("wrong-dimension",)),
            ("goal", {"waypoints": [{"position": position, "configuration": row}]}, ("two-destinations",)),
            ("goal", {"waypoints": 2 * [{"position": position, "t": 1.0}]}, ("times-not-increasing",)),
            ("goal", {"waypoints": [{"position": [1e3, 0.0]}]}, ("beyond-length",)),
            ("goal", {"waypoints": [{"position": position}], "speed": 1}, ("invalid-fields",)),
            ("plan", {"waypoints": [{"position": [1e3, 0.0]}]}, ("beyond-length",)),
            ("jog", {"actuators": {"9.9": "extended"}}, ("unknown-actuator",)),
            ("degrade", {"actuator": "9.9", "state": 1}, ("unknown-actuator",)),
            ("result", {"id": "nobody"}, ("unknown-goal",)),
            ("poses", {"remove": "nobody"}, ("unknown-pose",)),
        ]
        if not self._daemon.simulated:
            asked.append(("fault", {"fault": "silence can0/5"}, ("not-simulated",)))
        return self._random.choice(asked)

    def _chosen(self) -> Sequence[int]:
        """Returns the configurations for waypoints: those that can be reached, or all of them.

        Among obstacles a long way is often blocked: then most are near, and the stage there is clear.
        """
        space, discs, snapshot = self._daemon.space, self._daemon.exchange.possible, self._daemon.snapshot
        every = range(len(space.tips))
        if not self._willing or snapshot is None or not (reachable := self._reachable()):
            return every
        if not discs or self._random.random() < 0.2:
            return reachable
        start = states_from(snapshot)
        near = [(k, code) for k in reachable if ((code := int(space.codes[k])) ^ start).bit_count() <= NEAR]
        return [k for k, code in near if not any(space.touched(disc, start, code) for disc in discs)] or reachable

    def _reachable(self) -> list[int]:
        """Returns the configurations to which the arm can go now, with its locks and among the obstacles."""
        space, snapshot = self._daemon.space, self._daemon.snapshot
        start = -1 if snapshot is None else states_from(snapshot)
        if snapshot is None or start not in space.index:
            return []
        discs = tuple(sorted(self._daemon.exchange.possible))
        graph, costs = space.graph(unpack(snapshot.locked), start, discs), np.full(len(space.codes), np.inf)
        costs[space.index[start]] = 0.0
        reached = np.isfinite(graph.spread(costs)) & graph.permitted
        return [int(k) for k in np.flatnonzero(reached)]

    def position(self, unreachable: float = 0.0) -> list[float]:
        """Returns the tip of a configuration, or a position that perhaps no configuration reaches."""
        tip = self._daemon.space.tips[self._random.choice(self._chosen())]
        if not self._willing and self._random.random() < unreachable:
            tip = tip * 0.9
        return [float(x) for x in tip]

    def some_states(self) -> dict[str, str]:
        count = self._random.choice([1, 1, 2, len(self._labels)])
        return {label: self._random.choice(STATES) for label in self._random.sample(self._labels, count)}

    def lock(self) -> dict[str, Any]:
        """Returns a lock; some leave a module without state, or are not as commanded; no end-stop contradicts them."""
        random, snapshot = self._random, self._daemon.snapshot
        label, state = random.choice([*self._labels, self._labels[0], "9.9"]), random.choice([None, None, 0, 1])
        if snapshot is not None and random.random() < 0.3:
            contradicted = unpack(snapshot.sensed) & unpack(snapshot.known)
            every = [(k, value) for k in range(len(self._labels)) for value in (0, 1)]
            every = [(k, v) for k, v in every if not contradicted & (unpack(snapshot.measured) ^ v << k) >> k & 1]
            other = unpack(snapshot.outputs)
            bad = [(self._labels[k], v) for k, v in every if not self._leaves_states(k, v) or v != other >> k & 1]
            label, state = random.choice(bad or [(label, state)])
        return {"actuator": label, "state": state}

    def _leaves_states(self, k: int, value: int) -> bool:
        """Returns whether some configuration has an actuator in a state, and the locked ones in theirs."""
        snapshot, bit = self._daemon.snapshot, 1 << k
        assert snapshot is not None
        states, mask = unpack(snapshot.measured) & ~bit | value << k, unpack(snapshot.locked) | bit
        return any(not (code ^ states) & mask for code in self._daemon.space.index)

    def regions(self) -> list[dict[str, Any]]:
        """Returns discs on the way of some configurations; most do not touch the arm at rest."""
        discs = [self._disc() for _ in range(self._random.choice([0, 1, 1, 2, 3, 4]))]
        return [
            {"disc": {"centre": [disc.x, disc.y], "radius": disc.radius}, "name": f"disc{k}"}
            for k, disc in enumerate(discs)
        ]

    def _disc(self) -> Disc:
        random, space, snapshot = self._random, self._daemon.space, self._daemon.snapshot
        touches, tries = snapshot is None or random.random() < 0.04, 0
        while True:
            row, tries = random.choice(space.joints), tries + 1
            k, share, radius = random.randrange(len(row) - 1), random.random(), random.choice([0.01, 0.02, 0.05, 0.2])
            disc = Disc(*(float(x) for x in row[k] + share * (row[k + 1] - row[k])), radius)
            if touches or tries > MOST_TRIES or not space.touched(disc, code := unpack(snapshot.measured), code):
                return disc

    def pose(self) -> dict[str, Any]:
        """Returns a request on poses; a few are malformed."""
        random = self._random
        name = random.choice([*POSES, "home"]) if random.random() < 0.9 else random.choice(["", " a", "x" * 41, "a/b"])
        goal = {key: value for key, value in self.simple_goal().items() if key != "id"}
        goal |= random.choice([{}] * 20 + [{"id": "p"}, {"stamp": 5.0}, {"waypoints": []}])
        message = random.choice([{"save": name, "goal": goal}] * 3 + [{"remove": name}])
        return message if random.random() < 0.95 else random.choice([{"save": name}, {"goal": goal}, {}, {"remove": 5}])
