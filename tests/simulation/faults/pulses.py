"""Faults of pulses, and disturbances of commands on their way."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Frame
from tests.simulation.buses.bus_model import RPDOS
from tests.simulation.faults.fault import AT_ONCE, Fault, Maker, Told
from tests.simulation.faults.motion import ASKED, Switched, switched
from tests.simulation.faults.reads import READ_BACK

SHORT = 0.03  # [s]: a pulse that cannot be read twice is given again, unless an end-stop tells
OVERDUE = 2.0  # [s] until a pulse that may be on, and cannot be ended, is told
PULSING = 0.008  # [s] from the SYNC that begins a pulse until its bus goes down
LONGEST_HOLD = 0.015  # [s] for which frames stay in the controller, far below each time-out
DISTURBED = 0.3  # [s] in which nothing may be told of a disturbed command


def pulsed(make: Callable[[Switched, float], Fault | None]) -> Maker:
    def checked(it: Switched) -> Fault | None:
        return None if it.pulse is None else make(it, it.pulse)

    checked.__name__ = make.__name__
    return switched(checked)


def _lose(it: Switched, function: int) -> Callable[[], None]:
    return lambda: setattr(it.world.boards, "loses", (it.board, function))


@pulsed
def board_loses_the_end_of_a_pulse(it: Switched, pulse: float) -> Fault:
    frame = it.place.random.choice([cia301.RPDO1, cia301.SYNC])
    return Fault(it.at_sync(_lose(it, frame), pulse / 2), it.disarm, Told(within=DISTURBED + pulse))


@pulsed
def board_loses_the_SYNC_of_a_pulse(it: Switched, pulse: float) -> Fault | None:
    told = (it.sensed or pulse > SHORT) and not it.world.account.arm.forgone >> it.k & 1
    if it.world.arm.continue_on_stuck or not told:
        return None
    codes = ("stuck", "not-switched", "unexpected-motion", "pulse-overdue")
    expected = Told(codes, (it.label, it.board), (), READ_BACK + it.late, codes)
    return Fault(it.at_sync(_lose(it, cia301.SYNC), 0.0), it.disarm, expected)


@pulsed
def echo_is_lost_while_a_pulse_ends(it: Switched, pulse: float) -> Fault:
    return Fault(it.at_sync(it.bus.lose_echo, pulse / 2), it.disarm, Told(within=DISTURBED + pulse))


@pulsed
def nobody_answers_during_a_pulse(it: Switched, pulse: float) -> Fault | None:
    if not (it.sensed or pulse > SHORT):
        return None  # answers that were lost may still come, so a short pulse is not surely read

    def mute() -> None:
        it.bus.mute = True
        it.place.after(pulse, it.bus.hear_answers)

    return Fault(it.at_sync(mute, 0.0), it.disarm, Told(within=DISTURBED + pulse))


@pulsed
def board_is_unplugged_while_it_gets_a_pulse(it: Switched, pulse: float) -> Fault:
    timing = it.place.timing
    within = timing.heartbeat_timeout + timing.heartbeat + AT_ONCE + it.world.arm.rest + pulse
    told = Told(("board-lost",), (it.board,), (), within, ("pulse-overdue", "stuck"), clears=True)

    def plug() -> None:
        it.disarm()
        it.world.boards.fault("unsilence", it.board)

    return Fault(it.at_sync(it.place.do("silence", of=it.board), 0.0), plug, told)


@pulsed
def board_restarts_in_a_pulse(it: Switched, pulse: float) -> Fault:
    def restart() -> None:
        it.world.boards.fault("power_cut", it.board)
        it.world.boards.fault("power_on", it.board)

    also = ("stuck", "pulse-overdue", "unexpected-motion", "interlock")
    told = Told(("board-rebooted",), (it.board,), (), 0.5 + pulse + it.world.arm.rest, also)
    return Fault(it.at_sync(restart, pulse / 2), it.disarm, told)


@pulsed
def bus_is_down_while_a_pulse_is_on(it: Switched, pulse: float) -> Fault:
    within, also = it.world.arm.rest + ASKED, ("pulse-overdue", "board-lost")
    told = Told(("bus-down",), (it.bus.name,), (), within, also, clears=True)
    return Fault(it.at_sync(it.bus.go_down, PULSING), it.restore, told)


@pulsed
def bus_is_down_as_a_pulse_begins(it: Switched, pulse: float) -> Fault:
    told = Told(("pulse-overdue",), (it.channel.place,), (), OVERDUE, ("bus-down", "stuck"), clears=True)
    return Fault(it.at_sync(it.bus.go_down, 0.0), it.restore, told)


def _beside(it: Switched, fail: Callable[[Any], object]) -> Fault | None:
    """Another bus fails at the SYNC of a pulse."""
    others = [bus for name, bus in it.world.buses.items() if name != it.channel.bus]
    if not others:
        return None

    def end() -> None:
        it.disarm()
        others[0].restore()

    timing = it.place.timing
    within = timing.heartbeat_timeout + timing.heartbeat + AT_ONCE + it.world.arm.rest + 0.1
    told = Told(("board-lost", "bus-busy", "bus-down"), (), (), within, ("stuck",), clears=True)
    return Fault(it.at_sync(lambda: fail(others[0]), 0.0), end, told)


@pulsed
def another_bus_is_down_while_a_pulse_ends(it: Switched, pulse: float) -> Fault | None:
    return _beside(it, lambda other: other.go_down())


@pulsed
def another_bus_is_stuck_while_a_pulse_ends(it: Switched, pulse: float) -> Fault | None:
    return _beside(it, lambda other: setattr(other, "acknowledged", False))


# --- commands that are disturbed on their way: nothing may be told


def _on_the_way(name: str, disturb: Callable[[Switched, Callable[[], None]], Callable[[], object] | None]) -> None:
    """Adds a disturbance of a command. `disturb` takes the actuator and what holds frames in the controller."""

    def make(it: Switched) -> Fault | None:
        after = it.place.random.uniform(0.001, LONGEST_HOLD)

        def go_on() -> None:
            it.bus.stuck = False
            it.bus.begin()

        def hold() -> None:
            it.bus.stuck = True
            it.place.after(after, go_on)

        begin = disturb(it, hold)
        return None if begin is None else Fault(begin, it.restore, Told(within=it.late + (it.pulse or 0.0)))

    make.__name__ = name.replace(" ", "_")
    switched(make)


def _several(it: Switched) -> None:
    it.switch(it.place.random.choice([1, 2, 3]), max(it.travel), strict=it.place.random.random() < 0.5)


def _then(it: Switched, *steps: Callable[[], object]) -> Callable[[], None]:
    def begin() -> None:
        for step in steps:
            step()
        _several(it)

    return begin


def _cancel(it: Switched, hold: Callable[[], None]) -> Callable[[], None]:
    """Returns what holds frames, cancels their program, and perhaps asks for another one before they leave."""

    def happen() -> None:
        hold()
        it.place.after(0.0, it.world.planner.cancel_now)
        other = it.place.random.randrange(len(it.world.arm.actuators))
        if it.place.random.random() < 0.7:
            it.place.after(it.place.random.uniform(0.001, LONGEST_HOLD), lambda: it.world.ask_again(other))

    return happen


def _twice(frame: Frame) -> str:
    """Lets a bus bring each SYNC and RPDO twice."""
    return "twice" if frame.id == cia301.SYNC or frame.id & 0x780 in RPDOS else ""


def _fill(it: Switched) -> Callable[[], None]:
    def fill() -> None:
        it.bus.capacity = 0
        it.place.after(LONGEST_HOLD / 2, it.bus.restore)

    return fill


_on_the_way("RPDOs wait", lambda it, hold: _then(it, lambda: it.bus.at_next_rpdo(hold)))
_on_the_way("SYNC waits", lambda it, hold: _then(it, lambda: it.bus.at_next_sync(hold)))
_on_the_way("canceled while RPDOs wait", lambda it, hold: _then(it, lambda: it.bus.at_next_rpdo(_cancel(it, hold))))
_on_the_way("canceled while SYNC waits", lambda it, hold: _then(it, lambda: it.bus.at_next_sync(_cancel(it, hold))))
_on_the_way("queue is full after an RPDO", lambda it, hold: _then(it, lambda: it.bus.at_next_rpdo(_fill(it))))
_on_the_way("echo of an RPDO is lost", lambda it, hold: _then(it, lambda: it.bus.lose_echo(1, sync=False)))
_on_the_way("echo of a SYNC is lost", lambda it, hold: _then(it, lambda: it.bus.lose_echo(1, sync=True)))
_on_the_way("command comes twice", lambda it, hold: _then(it, it.place.intercept(_twice)))
_on_the_way(
    "RPDOs wait at the end of a pulse",
    lambda it, hold: it.at_sync(lambda: it.bus.at_next_rpdo(hold), it.pulse / 2) if it.pulse else None,
)
_on_the_way(
    "stopped in a pulse", lambda it, hold: it.at_sync(it.world.planner.halt, it.pulse / 2) if it.pulse else None
)
_on_the_way(
    "canceled in a pulse", lambda it, hold: it.at_sync(it.world.planner.cancel_now, it.pulse / 2) if it.pulse else None
)
