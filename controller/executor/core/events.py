"""Events and actions of the executor's core, as plain data."""

from collections.abc import Callable
from typing import NamedTuple

from hyperbit.controller.host.process import Log, Notify, Quit
from hyperbit.controller.messages.state import LoopTimes
from hyperbit.controller.program import Down, Up
from hyperbit.drivers.canopen.wire.cia301 import Frame
from hyperbit.drivers.canopen.wire.events import Event as CanEvent


class ClientId(NamedTuple):
    """A connection to the executor's socket: its number, never used again, and the process at the other end."""

    number: int
    pid: int


class ExecutorTick(NamedTuple):
    pass


class Health(NamedTuple):
    """Figures of the process, once a second; the core answers with `Diagnostics` to all clients."""

    loop: LoopTimes
    dropped: int
    journal: str | None


class FromClient(NamedTuple):
    client: ClientId
    message: Down


class ClientGone(NamedTuple):
    client: ClientId


class FaultPlayed(NamedTuple):
    client: ClientId
    request: int
    message: str
    played: bool


class Defect(NamedTuple):
    """The event loop itself has failed; the text is the traceback."""

    text: str


Event = CanEvent | ExecutorTick | Health | FromClient | ClientGone | FaultPlayed | Defect | Quit


class SendFrame(NamedTuple):
    bus: str
    frame: Frame


class ToClient(NamedTuple):
    """A message for a client. The server closes the connection after a `Goodbye`."""

    client: ClientId
    message: Up


class ToSimulation(NamedTuple):
    """A client's fault for simulated boards; answered by `FaultPlayed`."""

    client: ClientId
    request: int
    fault: str


Action = SendFrame | ToClient | ToSimulation | Notify | Log
Act = Callable[[Action], None]
