"""Faults of actuators, end-stops and interlocks, which an executor supervises."""

from __future__ import annotations

from collections.abc import Callable

from hyperbit.drivers.simulation.buses import ORDINARY
from tests.simulation.faults.fault import AT_ONCE, Fault, Maker, Place, Told, nothing, row

ASKED = 0.3  # [s] until the boards of a late actuator were asked
TIMES = 8  # stages that switch an actuator to and fro
LOOSE = 0.3  # [s] for which a wire is loose; a board that does not answer for longer is a fault
WAYS = {"clear": "answers", "touched": "finds an obstacle", "silent": "is silent", "stream": "sends set-points"}


class Switched:
    """An actuator that may be switched now.

    Attributes:
        at: the end to which it is driven; `sensed`: whether an end-stop tells its position.
        late: [s] from a command until it must have arrived, or is told as late.
    """

    def __init__(self, place: Place) -> None:
        self.place, self.world = place, place.world
        self.k, self.channel, self.label = place.k, place.channel, place.channel.actuator
        self.at = place.world.boards.positions() >> self.k & 1
        self.travel, self.margin = place.world.kinds.travel[self.k], place.world.kinds.margin[self.k]
        self.pulse: float | None = place.world.kinds.pulse.get(self.k)
        self.sensed = bool(place.world.account.arm.sensed >> self.k & 1)
        self.late = max(self.travel) + self.margin + place.world.arm.rest + ASKED
        self.bus = place.buses[self.channel.bus]
        self.board = f"{self.channel.bus}/{self.channel.node}"

    def switch(self, times: int = 1, pause: float = 0.0, strict: bool = False) -> None:
        self.world.planner.ask_to_switch(self.k, times, pause, strict)

    def at_sync(self, happen: Callable[[], object], after: float) -> Callable[[], None]:
        """Returns what switches it, and lets something happen a time [s] after its SYNC is handed out."""

        def begin() -> None:
            self.bus.at_next_sync(lambda: self.world.agenda.after(after, happen))
            self.switch()

        return begin

    def disarm(self) -> None:
        self.world.boards.loses = None
        self.bus.at_next_sync(nothing)
        self.bus.await_no_rpdo()
        self.bus.lose_echo(0)

    def restore(self) -> None:
        self.disarm()
        self.bus.restore()


def switched(make: Callable[[Switched], Fault | None]) -> Maker:
    """Adds a fault of an actuator that is switched."""

    def checked(at: Place) -> Fault | None:
        return make(Switched(at)) if at.world.may_switch(at.k) else None

    checked.__name__ = make.__name__
    return row("actuator")(checked)


@row("actuator", anytime=True, longest=2.0)
def door_is_opened(at: Place) -> Fault | None:
    if not at.wiring.interlocks:
        return None
    door = at.world.boards.door
    told = Told(("interlock",), ("door",), (), AT_ONCE, refused="interlock-open")
    return Fault(lambda: door("door", is_open=True), lambda: door("door", is_open=False), told)


@row("actuator", anytime=True, longest=4.0)
def actuator_moves_by_itself(at: Place) -> Fault:
    return _stick(at, 1 - at.world.boards.positions() >> at.k & 1 if at.random.random() < 0.5 else None)


def _stick(at: Place, end: int | None) -> Fault:
    now = at.world.boards.positions() >> at.k & 1
    end, label = 1 - now if end is None else end, at.channel.actuator
    within = at.world.kinds.travel[at.k][end] + ASKED
    supervised = at.world.account.arm.sensed >> at.k & 1 and end != now
    told = Told(("unexpected-motion",), (label,), (), within) if supervised else None
    return Fault(at.do("stick", end, of=label), at.do("release", of=label), told)


@row("actuator", anytime=True, longest=4.0)
def wires_are_shorted(at: Place) -> Fault:
    arm, label = at.world.account.arm, at.channel.actuator
    both = arm.extended_ends & arm.contracted_ends & 1 << at.k
    told = both and not at.channel.inverted & {"input", "input_contracted"}
    ends = Told(("end-stops",), (label,), (), ASKED)
    return Fault(at.do("short_wires", of=label), at.do("restore_sensor", of=label), ends if told else None)


@row("actuator", anytime=True, longest=4.0)
def wires_are_cut(at: Place) -> Fault:
    label = at.channel.actuator
    return Fault(at.do("cut_wires", of=label), at.do("restore_sensor", of=label), None)


@row("actuator", anytime=True, longest=4.0)
def sensor_is_lost(at: Place) -> Fault:
    label = at.channel.actuator
    return Fault(at.do("lose_sensor", of=label), at.do("restore_sensor", of=label), None)


@row("actuator", anytime=True, longest=4.0)
def actuator_is_slow(at: Place) -> Fault:
    label = at.channel.actuator
    slow = at.do("slow", at.random.choice([0.5, 2.5, 20]), of=label)
    return Fault(slow, at.do("slow", 1, of=label), None)


@row("actuator", anytime=True, longest=4.0)
def actuator_is_jammed(at: Place) -> Fault:
    label = at.channel.actuator
    return Fault(at.do("jam", at.random.choice([0.0, 0.02, 0.5, 1.0]), of=label), at.do("release", of=label), None)


@switched
def actuator_is_stuck(it: Switched) -> Fault | None:
    if not it.sensed:
        return None

    def begin() -> None:
        it.world.boards.fault("stick", it.label, it.at)
        it.switch()

    goes_on = it.world.arm.continue_on_stuck
    told = Told(("stuck",), (it.label,), (), it.late, ("unexpected-motion",), goes_on, locks=(it.label, goes_on))
    return Fault(begin, it.place.do("release", of=it.label), told)


@switched
def actuator_misses_commands(it: Switched) -> Fault | None:
    if not it.sensed or it.world.arm.continue_on_stuck:
        return None
    pause = max(it.travel) + it.margin / 2 + it.world.arm.rest

    def begin() -> None:
        it.world.boards.fault("stick", it.label, it.at)
        it.switch(TIMES, pause)

    told = Told(("stuck",), (it.label,), (), TIMES * pause + it.late, ("unexpected-motion",), locks=(it.label, False))
    return Fault(begin, it.place.do("release", of=it.label), told)


@switched
def actuator_arrives_within_its_margin(it: Switched) -> Fault | None:
    if not it.sensed:
        return None
    travel = it.travel[1 - it.at]

    def begin() -> None:
        it.world.boards.fault("slow", it.label, (travel + 0.7 * it.margin) / (ORDINARY * travel))
        it.switch()

    return Fault(begin, it.place.do("slow", 1, of=it.label), Told(within=it.late))


@switched
def TPDO_is_lost(it: Switched) -> Fault | None:
    def begin() -> None:
        it.bus.tpdos_to_lose = 1
        it.switch()

    return Fault(begin, it.restore, Told(within=it.late)) if it.sensed else None


def _loose(way: str) -> Callable[[Switched], Fault | None]:
    """Cuts the wires of an end-stop for a moment, in which its board cannot be asked, before a strict stage."""

    def make(it: Switched) -> Fault | None:
        others = (k for k in range(len(it.world.arm.actuators)) if k != it.k and k not in it.world.kinds.pulse)
        free = [k for k in others if it.world.may_switch(k)]
        one = (
            it.channel.input is not None and it.channel.input_contracted is None and "input" not in it.channel.inverted
        )
        if not (one and it.at and free) or it.world.account.locked:
            return None

        def begin() -> None:
            it.bus.mute = True
            it.world.boards.fault("cut_wires", it.label)
            it.place.after(LOOSE / 5, lambda: it.world.planner.ask_strictly(it.place.random.choice(free), way))
            it.place.after(LOOSE, it.place.do("restore_sensor", of=it.label))
            it.place.after(LOOSE, it.bus.hear_answers)

        return Fault(begin, told=Told(within=0.8, asks=True))

    make.__name__ = f"wires_are_loose,_the_planner_{WAYS[way].replace(' ', '_')}"
    return make


for _way in WAYS:
    switched(_loose(_way))
