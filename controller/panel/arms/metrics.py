"""Metrics of all arms in Prometheus' text format, computed from published messages without requests to daemons."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from importlib.metadata import version
from typing import Protocol

from msgspec import UnsetType
from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from starlette.requests import Request
from starlette.responses import Response

from hyperbit.controller.messages.goals import Result
from hyperbit.controller.messages.state import Diagnostics, State
from hyperbit.controller.network.fault_changes import ActiveFaults, active
from hyperbit.controller.panel.arms.faults import ADVICE

STATUSES = ("succeeded", "canceled", "replaced", "aborted")
MODES = ("starting", "ready", "executing", "fault", "stopped")
MOST_ACTUATORS = 500  # larger arms have no series for each actuator: Prometheus keeps each series for weeks
MOST_KINDS = 100  # codes or statuses of one arm; further ones are counted as "other"
QUANTILES = (("0.5", "late_p50"), ("0.99", "late_p99"), ("1", "late_worst"))


class Seen(Protocol):
    """Data of one arm.

    Attributes:
        alive: whether its daemon is running.
        state: the latest one.
        diagnostics: the latest ones.
        actuators: labels, in the order of `diagnostics.counts`; empty while they are unknown.
    """

    @property
    def name(self) -> str: ...  # see above
    @property
    def alive(self) -> bool: ...
    @property
    def state(self) -> State | None: ...
    @property
    def diagnostics(self) -> Diagnostics | None: ...
    @property
    def actuators(self) -> Iterable[str]: ...


class Counters:
    """Counts results by arm and status, and new faults by arm and code. Not thread-safe."""

    def __init__(self) -> None:
        self.goals: Counter[tuple[str, str]] = Counter()
        self.faults: Counter[tuple[str, str]] = Counter()
        self._active: dict[str, ActiveFaults] = {}

    def result(self, arm: str, result: Result) -> None:
        count(self.goals, arm, result.status)

    def state(self, arm: str, state: State) -> None:
        """Counts the new faults of a state."""
        for code, _ in self._active.setdefault(arm, ActiveFaults()).take(state).came:
            count(self.faults, arm, code)

    def drop_arm(self, arm: str) -> None:
        self._active.pop(arm, None)
        for counts in (self.goals, self.faults):
            for key in [key for key in counts if key[0] == arm]:
                del counts[key]


def endpoint(arms: Callable[[], Iterable[Seen]], counters: Counters) -> Callable[[Request], Response]:
    def metrics(request: Request) -> Response:
        return Response(exposition(arms(), counters), media_type=CONTENT_TYPE_LATEST)

    return metrics


def exposition(arms: Iterable[Seen], counters: Counters) -> bytes:
    class Collector:
        def collect(self) -> Iterator[Metric]:
            return iter(figures(arms, counters))

    registry = CollectorRegistry()
    registry.register(Collector())
    return generate_latest(registry)


def figures(arms: Iterable[Seen], counters: Counters) -> list[Metric]:
    """Returns all metrics; omits values that an arm has not published."""
    info = GaugeMetricFamily("hyperbit_build_info", "Version of hyperbit.", labels=["version"])
    info.add_metric([version("hyperbit")], 1.0)
    goals = CounterMetricFamily("hyperbit_goals", "Results of goals, jogs included.", labels=["arm", "status"])
    faults = CounterMetricFamily("hyperbit_faults", "Faults that began.", labels=["arm", "code"])
    seen = list(arms)
    # A series that begins with its first event has no increase in Prometheus, so each begins with 0.
    for family, counts, kinds in ((goals, counters.goals, STATUSES), (faults, counters.faults, tuple(ADVICE))):
        every = dict.fromkeys(((arm.name, kind) for arm in seen for kind in kinds), 0) | counts
        for labels, number in every.items():
            family.add_metric(labels, number)
    return [info, goals, faults, *of_states(seen), *of_diagnostics(seen)]


def of_states(arms: Iterable[Seen]) -> list[Metric]:
    alive = GaugeMetricFamily("hyperbit_alive", "Whether the arm's daemon is there.", labels=["arm"])
    simulated = GaugeMetricFamily("hyperbit_simulated", "Whether the arm's boards are simulated.", labels=["arm"])
    mode = GaugeMetricFamily("hyperbit_mode", "1 for the mode that the arm is in.", labels=["arm", "mode"])
    faults = GaugeMetricFamily("hyperbit_fault_active", "1 for each active fault.", labels=["arm", "code", "source"])
    locked = GaugeMetricFamily("hyperbit_actuators_locked", "Actuators that are locked.", labels=["arm"])
    for arm in arms:
        alive.add_metric([arm.name], float(arm.alive))
        if (state := arm.state) is None:
            continue
        simulated.add_metric([arm.name], float(state.simulated))
        for name in MODES:
            mode.add_metric([arm.name, name], float(state.mode == name))
        for labels in active(state):
            faults.add_metric([arm.name, *labels], 1.0)
        locked.add_metric([arm.name], len(state.degraded))
    return [alive, simulated, mode, faults, locked]


def of_diagnostics(arms: Iterable[Seen]) -> list[Metric]:
    per_actuator = CounterMetricFamily("hyperbit_switches", "Switches of an actuator.", labels=["arm", "actuator"])
    all_switches = CounterMetricFamily("hyperbit_arm_switches", "Switches of all actuators.", labels=["arm"])
    late = GaugeMetricFamily(
        "hyperbit_cycle_late_seconds", "Lateness of control cycles in the last second.", labels=["arm", "quantile"]
    )
    overruns = GaugeMetricFamily("hyperbit_cycle_overruns", "Cycles missed in the last second.", labels=["arm"])
    load = GaugeMetricFamily("hyperbit_bus_load_ratio", "Share of the bus that is used.", labels=["arm", "bus"])
    frames = CounterMetricFamily("hyperbit_bus_frames", "Frames on a bus.", labels=["arm", "bus", "direction"])
    errors = GaugeMetricFamily("hyperbit_bus_errors", "CAN error counters.", labels=["arm", "bus", "direction"])
    age = GaugeMetricFamily("hyperbit_board_heartbeat_age_seconds", "Age of a heartbeat.", labels=["arm", "board"])
    up = GaugeMetricFamily("hyperbit_board_operational", "Whether a board is operational.", labels=["arm", "board"])
    queue = GaugeMetricFamily("hyperbit_queue_length", "Requests that wait.", labels=["arm", "queue"])
    setpoints = CounterMetricFamily("hyperbit_setpoints", "Set-points heard.", labels=["arm", "outcome"])
    waits = CounterMetricFamily("hyperbit_clearance_waits", "Cycles that waited for a clearance.", labels=["arm"])
    for arm in arms:
        if (latest := arm.diagnostics) is None:
            continue
        labels, counts, loop = list(arm.actuators), latest.counts, latest.loop
        if counts:
            all_switches.add_metric([arm.name], sum(counts))
        if len(counts) == len(labels) <= MOST_ACTUATORS:
            for label, switches in zip(labels, counts, strict=True):
                per_actuator.add_metric([arm.name, label], switches)
        for quantile, field in QUANTILES:
            put(late, [arm.name, quantile], getattr(loop, field))
        put(overruns, [arm.name], loop.overruns)
        for bus in latest.buses:
            load.add_metric([arm.name, bus.name], bus.load)
            for direction in ("tx", "rx"):
                frames.add_metric([arm.name, bus.name, direction], getattr(bus, f"{direction}_frames"))
                errors.add_metric([arm.name, bus.name, direction], getattr(bus, f"{direction}_errors"))
        for board in latest.boards:
            name = f"{board.bus}/{board.node}"
            put(age, [arm.name, name], board.heartbeat_age)
            up.add_metric([arm.name, name], float(board.state == "operational"))
        for name, length in latest.queues.items():
            queue.add_metric([arm.name, name], length)
        if latest.setpoint:
            setpoints.add_metric([arm.name, "received"], latest.setpoint.received)
            setpoints.add_metric([arm.name, "refused"], latest.setpoint.refused)
        put(waits, [arm.name], latest.waits)
    families = (per_actuator, all_switches, late, overruns, load, frames, errors, age, up, queue, setpoints, waits)
    return list(families)


def count(counts: Counter[tuple[str, str]], arm: str, kind: str) -> None:
    """Increments the counter of a kind; beyond MOST_KINDS kinds of an arm, the counter "other"."""
    known = (arm, kind) in counts or sum(name == arm for name, _ in counts) < MOST_KINDS
    counts[arm, kind if known else "other"] += 1


def put(family: GaugeMetricFamily | CounterMetricFamily, labels: list[str], value: float | UnsetType | None) -> None:
    """Adds a figure, unless the daemon does not know it."""
    if isinstance(value, int | float):
        family.add_metric(labels, value)
