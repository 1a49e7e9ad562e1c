"""What is handed to the control loop: all it acts on besides time and the boards' faults."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from controller.daemon.avoidance import Kept
from controller.manipulator.held import Held
from controller.manipulator.manipulator import Configuration
from controller.motion.degrade import DegradeMessage
from controller.motion.plan import Plan
from drivers.faults import Fault

Payload = Mapping[str, Any]
Reply = Callable[[Payload], None]


@dataclass(frozen=True, eq=False)
class Request:
    """What a peer asks for, and is answered exactly once.

    Attributes:
        arrival: its place among all requests.
        reply: takes the answer; must not wait.
    """

    arrival: int
    reply: Reply


@dataclass(frozen=True, eq=False)
class Planned(Request):
    """A goal that has a plan and asks to be run; `kept` is what the plan keeps clear of, None for nothing."""

    id: str
    plan: Plan
    kept: Kept | None = None


@dataclass(frozen=True, eq=False)
class Improved:
    """A better plan for a goal that is being run, told by its arrival; `kept`: see Planned."""

    arrival: int
    plan: Plan
    kept: Kept | None = None


@dataclass(frozen=True, eq=False)
class Follow:
    """What a moving goal asks for until the next of these comes.

    Attributes:
        arrival: place among all requests of the first setpoint in the stream.
        previous: the loop's configuration from which this was decided, itself, shape (B,); None: not known.
        configuration: to switch to once the last transition is settled, shape (B,); None: stay.
        until: when the stream has stopped, unless another of these comes before [s on the loop's clock].
        reason: a sentence on what is followed.
        stages: actuator states that each stage on the way ends in, shape (k, A); None: the configuration's alone.
    """

    arrival: int
    previous: Configuration | None
    configuration: Configuration | None
    until: float
    reason: str
    stages: NDArray[np.uint8] | None = None


class Cancel(Request):
    """Hold now, and take no goal or stream that began before."""


class Stop(Request):
    """Emergency stop."""


class Reset(Request):
    """Leave a fault or a stop."""


@dataclass(frozen=True, eq=False)
class Degrade(Request):
    """Hold an actuator in a state from now on, or use it again."""

    wish: DegradeMessage


@dataclass(frozen=True, eq=False)
class KeepOut(Request):
    """Keep clear of something else from now on."""

    kept: Kept


@dataclass(frozen=True, eq=False)
class Judged:
    """What is touched by what is left of the goal of an arrival, of what was to be kept clear of; None: nothing."""

    arrival: int
    kept: Kept
    touched: str | None


@dataclass(frozen=True, eq=False)
class Prepared:
    """Planning goes by actuators that are held (A,), or does not, for a fault."""

    held: Held
    fault: Fault | None = None


@dataclass(frozen=True, eq=False)
class Started:
    """The boards' start-up has ended; with no faults all are operational."""

    faults: tuple[Fault, ...]


@dataclass(frozen=True, eq=False)
class Quit:
    """The service is asked to end."""


Event = Request | Improved | Follow | Judged | Prepared | Started | Quit
