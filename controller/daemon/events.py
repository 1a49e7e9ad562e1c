"""What is handed to the control loop: all it acts on besides time and the boards' faults."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

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
    """A goal that has a plan and asks to be run."""

    id: str
    plan: Plan


@dataclass(frozen=True, eq=False)
class Improved:
    """A better plan for a goal that is being run, told by its arrival."""

    arrival: int
    plan: Plan


@dataclass(frozen=True, eq=False)
class Follow:
    """What a moving goal asks for until the next of these comes.

    Attributes:
        arrival: place among all requests of the first setpoint in the stream.
        previous: the loop's configuration from which this was decided, itself, shape (B,); None: not known.
        configuration: to switch to once the last transition is settled, shape (B,); None: stay.
        until: when the stream has stopped, unless another of these comes before [s on the loop's clock].
        reason: a sentence on what is followed.
    """

    arrival: int
    previous: Configuration | None
    configuration: Configuration | None
    until: float
    reason: str


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


Event = Request | Improved | Follow | Prepared | Started | Quit
