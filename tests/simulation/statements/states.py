"""Statements on `state` and on obstacles: what is told is true, and no stage touches what was confirmed."""

from __future__ import annotations

import math

from hyperbit.controller.executor.core.events import Event, FromClient
from hyperbit.controller.program import Accepted, Clearance, Question, Snapshot, Up, unpack
from hyperbit.drivers.canopen.wire.cia301 import Frame
from tests.simulation.buses.bus_model import RPDOS
from tests.simulation.statements.asked import Payload, Ran, Request, discs_of, measured_of, states_from
from tests.simulation.statements.exchange import Exchange
from tests.simulation.statements.mechanics import Mechanics
from tests.simulation.statements.motions import Switch
from tests.simulation.statements.results import OfTheArm, codes_of
from tests.simulation.whole.configurations import Disc

LATE = 0.1  # [s], awake: 20 states a second, and the outbox
BIAS_WITHIN = 2e-4  # from the tracker's offset
OWN = {"degraded", "unknown-state", "in-obstacle", "executor-lost", "internal-error"}  # faults of the planner
SHELL = {"clock-set", "certificate-ends", "network-lost", "ledger-unwritten"}


class StatesAreTrue(OfTheArm):
    """What `state` tells held in the last 0.1 s: one snapshot of the executor explains all of its fields."""

    number = 5
    least = 2000

    def state(self, payload: Payload) -> None:
        whys = list[str]()
        for snapshot in self.exchange.lately(LATE):
            whys.append(self._differs(payload, snapshot))
            if not whys[-1]:
                break
        self.require(not whys[-1], lambda: f"state {payload}: {whys}")
        self._judge_goal(payload["goal"])
        bias = payload.get("bias") or [0.0, 0.0]
        near = math.dist(bias, self.exchange.offset) < BIAS_WITHIN or not any(bias)
        self.require(near, lambda: f"state tells the bias {bias}; it is {self.exchange.offset}")

    def answered(self, request: Request, answer: Payload) -> None:
        """The description has the obstacles in force, if none were sent since it was asked for."""
        if request.key == "arm" and "sent_obstacles" in answer and self.exchange.kept_obstacles(request.at):
            told = discs_of(answer["sent_obstacles"])
            self.require(told == self.exchange.confirmed, lambda: f"arm tells {told}, not {self.exchange.confirmed}")

    def _judge_goal(self, goal: str | None) -> None:
        exchange = self.exchange
        mine = [ran for ran in exchange.programs.values() if ran.process == exchange.process and not ran.given_up]
        if goal is None:
            runs = [r for r in mine if r.instance == exchange.instance and r.ended is None]
            runs = [r.goal for r in runs if exchange.awake - r.awake > LATE and exchange.snapshot is not None]
            self.require(not runs, lambda: f"state names no goal, and {runs} run")
        else:
            runs = [r.goal for r in mine if exchange.awake - r.over_at < LATE]
            self.require(goal in runs, lambda: f"state names the goal {goal}; {runs} run")

    def steps(self) -> None:
        exchange = self.exchange
        late = exchange.awake - max(exchange.told_at, exchange.began + 0.5)
        if exchange.process and not exchange.quits and late > LATE:
            self.require(False, f"no state for {late:g} s")

    def _differs(self, payload: Payload, snapshot: Snapshot | None) -> str:
        """Returns in which field a state differs from a snapshot; "" if in none."""
        size = len(self.mechanics.labels)
        if snapshot is None:
            silent = payload["measured"] == [None] * size and payload["commanded"] is None and payload["tip"] is None
            return "" if payload["mode"] in ("fault", "starting") and silent else "there is no connection"
        rebuilding = snapshot.mode == "ready" and payload["mode"] in ("starting", "fault")  # the planner's tables
        if payload["mode"] != snapshot.mode and not (rebuilding and "tables" in payload["reason"]):
            return f"the mode is {snapshot.mode}"
        known, locked = unpack(snapshot.known), unpack(snapshot.locked)
        surely = known | unpack(snapshot.homing) == (1 << size) - 1
        start = states_from(snapshot)
        wanted: Payload = {
            "measured": measured_of(snapshot.known, snapshot.measured, size),
            "commanded": [start >> k & 1 for k in range(size)] if surely else None,
            "unread": [label for k, label in enumerate(self.mechanics.labels) if unpack(snapshot.unread) >> k & 1],
        }
        if surely and not snapshot.moving:
            held = [k for k in range(size) if (locked & known) >> k & 1]
            wanted["degraded"] = [
                {"actuator": self.mechanics.labels[k], "state": unpack(snapshot.measured) >> k & 1} for k in held
            ]
        for name, value in wanted.items():
            if payload[name] != value:
                return f"{name} is {value}"
        return self._differs_in_tip(payload, snapshot) or self._differs_in_faults(payload, snapshot, surely, start)

    def _differs_in_tip(self, payload: Payload, snapshot: Snapshot) -> str:
        tip, told = self.mechanics.tips.get(self.mechanics.code(snapshot.known, snapshot.measured)), payload["tip"]
        if tip is None or told is None:
            return "" if tip is None and told is None and payload["configuration"] is None else f"the tip is {tip}"
        return "" if tip.near(told) and payload["configuration"] == tip.notation else f"the tip is {tip}"

    def _differs_in_faults(self, payload: Payload, snapshot: Snapshot, surely: bool, start: int) -> str:
        told = {(f["code"], f["source"]) for f in payload["faults"]}
        theirs = {(f.code, f.source) for f in snapshot.faults if f.code != "degraded"}
        extra = {fault for fault in told - theirs if fault[0] not in OWN | SHELL}
        if extra or theirs - told:
            return f"the executor's faults are {theirs}"
        odd = surely and not snapshot.moving and start not in self.mechanics.tips
        codes = {code for code, _ in told}
        if ("unknown-state" in codes) != odd or "executor-lost" in codes:
            return f"unknown-state: {odd}, and the executor is connected"
        return ""


class ToldNumbersNeverFall(OfTheArm):
    """The numbers of obstacles and poses, and the counts of switches, never fall while a process lives."""

    number = 13
    least = 1500

    def __init__(self, exchange: Exchange, mechanics: Mechanics) -> None:
        super().__init__(exchange, mechanics)
        self._latest: dict[str, int] = {}
        self._taken = self._malformed = 0  # set-points that the core had taken at the last diagnostics

    def planner_begins(self) -> None:
        self._latest.clear()
        self._taken = self._malformed = 0

    def state(self, payload: Payload) -> None:
        for name in ("obstacles", "poses"):
            self._grows(name, payload[name])

    def diagnostics(self, payload: Payload) -> None:
        told, exchange = payload["setpoint"], self.exchange
        for name in ("streams", "received", "refused"):
            self._grows(name, told[name])
        right = self._taken <= told["received"] <= exchange.taken and told["refused"] >= self._malformed
        self.require(right, lambda: f"diagnostics tells {told}; {exchange.taken} set-points came")
        self._taken, self._malformed = exchange.taken, exchange.malformed
        for k, count in enumerate(payload["counts"]):
            self._grows(f"count of actuator {k}", count)

    def _grows(self, name: str, number: int) -> None:
        before = self._latest.get(name, 0)
        self.require(number >= before, lambda: f"the number {name} falls from {before} to {number}")
        self._latest[name] = number


class NoStageTouchesAnObstacle(OfTheArm):
    """No stage touches an obstacle that was confirmed before its frames, if it was known where the arm was."""

    number = 14
    least = 150

    def __init__(self, exchange: Exchange, mechanics: Mechanics) -> None:
        super().__init__(exchange, mechanics)
        self._among = exchange.in_force  # when the last RPDO was handed out
        self._before: int | None = None  # where the arm was then, as the executor knew; None: it did not
        self._asked: dict[int, tuple[Question, frozenset[Disc]]] = {}  # by number, with the obstacles in force
        self._unchecked: set[int | None] = set()  # jogs from where nobody knows, as their answers say

    def started(self) -> None:
        self._asked.clear()
        self._unchecked.clear()

    def says(self, message: Up) -> None:
        asked = self.account.message
        if isinstance(message, Question):
            self._asked[message.question] = message, self.exchange.in_force
        elif isinstance(message, Accepted) and self.account.homing and asked.name.startswith("jog "):
            self._unchecked.add(message.program)

    def accepts(self, ran: Ran) -> None:
        """A program among obstacles that have not changed since its request has no stage that touches one."""
        request = ran.request
        if request is None or ran.jog or ran.start is None or not self.exchange.kept_obstacles(request.at):
            return
        before, text = ran.start[0], f"{ran.program} for {request}"
        for after, _ in codes_of(ran) if before in self.mechanics.tips else ():
            touched = [disc for disc in self.exchange.confirmed if self.mechanics.space.touched(disc, before, after)]
            self.require(not touched, lambda: f"{text}: from {before:b} to {after:b} touches {touched}")  # noqa: B023
            before = after

    def told(self, event: Event) -> None:
        """A stage is called clear only if it touches nothing that was in force all the time."""
        match event:
            case FromClient(_, Clearance(number, None)) if number in self._asked:
                question, among = self._asked.pop(number)
                before, after = unpack(question.start), unpack(question.stage)
                space, still = self.mechanics.space, among & self.exchange.in_force
                touched = [disc for disc in still if space.touched(disc, before, after)]
                self.require(not touched, lambda: f"{question} is answered as clear, and touches {touched}")

    def sends(self, bus: str, frame: Frame) -> None:
        if frame.id & 0x780 in RPDOS:
            shown, pins = self.account.shown, self.account.pins.now.states
            self._among = self.exchange.in_force
            held = 0 if shown is None else unpack(shown.locked)
            known = shown is not None and unpack(shown.known) == (1 << self.account.arm.count) - 1
            fits = known and shown is not None and not (unpack(shown.outputs) ^ pins) & ~held
            self._before = None
            if fits and shown is not None:
                still = 0 if shown.moving else -1
                self._before = unpack(shown.measured) & (held | still) | pins & ~(held | still)

    def switches(self, switch: Switch) -> None:
        snapshot = self.exchange.snapshot
        before = self._before
        if switch.cause != "SYNC" or before is None or not self._among or snapshot is None:
            return
        starts = [motion.start for motion, _ in switch.sync.asked] if switch.sync is not None else []
        if not starts or any(start not in self.mechanics.tips for start in starts):
            return  # a jog from no configuration is not checked, either
        if switch.sync is not None and switch.sync.program in self._unchecked:
            return
        locked, pins = unpack(snapshot.locked), self.account.pins.now.states
        after = (pins ^ switch.mask) & ~locked | before & locked
        touched = [disc for disc in self._among if self.mechanics.space.touched(disc, before, after)]
        self.require(not touched, lambda: f"a stage from {before:b} to {after:b} touches {touched}")
