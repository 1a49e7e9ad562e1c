"""Faults of the processes of the daemon, of what they need, and of what they do at the wrong moment."""

from __future__ import annotations

from collections.abc import Callable

from hyperbit.controller.executor.core.events import Defect
from tests.simulation.executor.process import LOOP_FAILS
from tests.simulation.faults.fault import AT_ONCE, Fault, Place, Told, row

DISK = "the disk is full"
STEPS = (-3600.0, -1.0, -0.1, 0.1, 1.0, 3600.0)  # [s] by which the clock is set
FIGURES = 3.1  # [s] in which the loop passes its figures at least once, though it may be too late twice
STILL = 8.0  # [s], longest standstill of a planner


@row("process")
def journal_is_not_written(at: Place) -> Fault:
    def end() -> None:
        at.world.habits.problem = None
        at.world.pass_time(FIGURES)

    told = Told(("journal",), ("executor",), (DISK,), FIGURES, clears=True, warns=True)
    return Fault(lambda: setattr(at.world.habits, "problem", DISK), end, told)


@row("process")
def executors_loop_fails(at: Place) -> Fault:
    return Fault(at.tell(Defect(LOOP_FAILS)), told=Told(("internal-error",), ("executor",), (), AT_ONCE))


@row("process", anytime=True)
def executor_is_killed_after_some_actions(at: Place) -> Fault:
    def begin() -> None:
        if at.world.daemon is not None and at.random.random() < 0.5:
            at.world.daemon.clients.rush()
        at.world.executor.kill_after(at.random.randint(0, 20))

    return Fault(begin, told=None)


@row("process", anytime=True)
def executor_is_restarted(at: Place) -> Fault:
    return Fault(at.world.executor.quit, told=None)


@row("process", anytime=True)
def planner_hangs(at: Place) -> Fault:
    def begin() -> None:
        delay = 0.0 if at.world.daemon is None else at.world.daemon.clients.hurry()
        at.after(delay, lambda: at.world.planner.stall(at.random.choice([0.3, 0.9, 1.2, 3.0])))

    return Fault(begin, told=None)


@row("process", anytime=True)
def planner_dies(at: Place) -> Fault:
    def begin() -> None:
        at.world.planner.die()
        if at.world.daemon is not None:
            at.world.daemon.clients.move()

    return Fault(begin, told=None)


@row("process", anytime=True, longest=0.15)
def arm_is_stopped_while_frames_of_a_command_wait(at: Place) -> Fault:
    def happen() -> None:
        at.bus.acknowledged = False
        at.world.planner.connection.halt()

    def end() -> None:
        at.bus.await_no_rpdo()
        at.bus.restore()

    return Fault(lambda: at.bus.at_next_rpdo(happen), end, None)


@row("process", anytime=True, longest=4.0)
def wires_are_loose_before_strict_stages(at: Place) -> Fault:
    """Wires of an extended actuator are cut, and its board answers late: the stage begins from other states."""
    going = [True]

    def consider() -> None:
        if going:
            if any(motion.strict for motion in at.world.account.wanted) and at.random.random() < 0.9:
                at.after(at.random.uniform(0.0, 0.05), loosen)
            at.bus.at_next_rpdo(consider)

    def loosen() -> None:
        channels, positions = at.wiring.channels, at.world.boards.positions()
        one = [c.input is not None and c.input_contracted is None and "input" not in c.inverted for c in channels]
        extended = [c for k, c in enumerate(channels) if one[k] and positions >> k & 1]
        if going and extended:
            channel = at.random.choice(extended)
            bus = at.buses[channel.bus]
            bus.answer_delay = 1.0
            at.boards.fault("cut_wires", channel.actuator)
            at.after(at.random.uniform(0.0, 1.0), at.do("restore_sensor", of=channel.actuator))
            at.after(at.random.uniform(0.0, 1.0), bus.restore)

    return Fault(consider, going.clear, None)


# --- the whole daemon


def _add(
    name: str, longest: float, begin: Callable[[Place], object], end: Callable[[Place], object] = lambda at: None
) -> None:
    """Adds a fault of which nobody can say what it leads to."""

    def make(at: Place) -> Fault | None:
        return None if at.world.daemon is None else Fault(lambda: begin(at), lambda: end(at), None)

    make.__name__ = name.replace(" ", "_")
    row("daemon", anytime=True, longest=longest)(make)


def _mood(name: str, *values: float) -> Callable[[Place], object]:
    return lambda at: setattr(at.world.daemon.mood, name, at.random.choice(values))


def _in_motion(at: Place, happen: Callable[[], object]) -> Fault:
    """Returns what lets something happen once, soon after the next stage has begun."""
    waits = [True]

    def perform() -> None:
        if waits:
            waits.clear()
            happen()

    def begin() -> None:
        for bus in at.buses.values():
            bus.at_next_rpdo(lambda: at.after(at.random.uniform(0.0, 0.2), perform))

    return Fault(begin, waits.clear, None)


@row("daemon", anytime=True, longest=4.0)
def executor_dies_in_motion(at: Place) -> Fault | None:
    if at.world.daemon is None:
        return None
    fault = _in_motion(at, at.world.executor.kill)
    return fault._replace(begin=lambda: (at.world.daemon.clients.move(), fault.begin()))


@row("daemon", anytime=True, longest=4.0)
def planner_dies_in_motion(at: Place) -> Fault | None:
    return None if at.world.daemon is None else _in_motion(at, at.world.daemon.die)


def _kill_both(at: Place) -> None:
    at.world.daemon.die()
    at.world.executor.kill_after(at.random.randint(0, 20))


def _die_in_write(at: Place) -> None:
    at.world.executor.die_in_write()
    at.world.daemon.clients.move()


def _hang(at: Place) -> None:
    if at.random.random() < 0.01:  # each takes minutes
        at.world.daemon.mood.hangs = True


_add("planner is restarted", 0.0, lambda at: at.world.daemon.end_in_order())
_add("both are killed", 0.0, _kill_both)
_add("executor dies in a write", 4.0, _die_in_write, lambda at: at.world.executor.recover())
_add("planner stands still", 0.0, lambda at: at.world.daemon.stall(at.random.choice([2.5, 4.5, STILL])))
_add("searches are late", 6.0, _mood("delay", 0.1, 0.5, 3.0), lambda at: at.world.daemon.mood.mend())
_add("searches fail", 3.0, _mood("fails", 0.1, 0.5, 1.0), lambda at: at.world.daemon.mood.mend())
_add("search hangs", 0.0, _hang)
_add("searches err", 4.0, lambda at: at.world.daemon.err(0.5), lambda at: at.world.daemon.err(0.0))
_add("clock is set", 0.0, lambda at: at.world.daemon.set_clock(at.random.choice(STEPS)))
_add(
    "planner is slow",
    4.0,
    lambda at: at.world.daemon.hold_up(slow=at.random.choice([0.002, 0.02, 0.2])),
    lambda at: at.world.daemon.mend(),
)
_add(
    "clients read slowly",
    3.0,
    lambda at: at.world.daemon.hold_up(congestion=at.random.choice([0.005, 0.1])),
    lambda at: at.world.daemon.mend(),
)
_add(
    "planners disk is full",
    4.0,
    lambda at: at.world.daemon.fill_disk(at.random.choice([0, 0, 1, 2, 5])),
    lambda at: at.world.daemon.mend(),
)
_add(
    "network is lost",
    3.0,
    lambda at: at.world.daemon.lose_network(True),
    lambda at: at.world.daemon.lose_network(False),
)
_add(
    "executors socket is full",
    0.6,
    lambda at: (at.world.daemon.fill_socket(at.random.choice([0, 0, 1, 2, 5])), at.world.daemon.clients.move()),
    lambda at: at.world.daemon.drain_socket(),
)
_add(
    "clients send bytes that are no text",
    0.0,
    lambda at: at.world.daemon.clients.ask(at.random.choice(["goal", "jog", "reset", "obstacles"]), b'{"id": "\xff"}'),
)
