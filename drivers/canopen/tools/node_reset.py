"""Resets one node by NMT and waits for its boot-up message (CiA 301, 7.2.8.3.1)."""

from __future__ import annotations

from collections.abc import Callable

from drivers.canopen.faults import ArmFault
from drivers.canopen.tools.conversation import converse
from drivers.canopen.wire import cia301
from drivers.canopen.wire.bus import CanBus
from drivers.canopen.wire.cia301 import Command, Frame, State
from drivers.canopen.wire.events import BusChanged, Event, FrameEchoed, FrameReceived
from drivers.canopen.wire.link import Link, Outgoing
from drivers.canopen.wiring import BusWiring

_STUCK_AFTER = 0.5  # [s]


class NodeReset:
    """The reset of one node; without I/O and clock, like the master.

    Attributes:
        booted_after: time from the reset to the boot-up message [s]; None if none came.
        fault: why the bus could not be used; None if it could.

    Args:
        bus: the bus.
        node: node id.
        timeout: longest wait for the boot-up message [s].
        send: hands out a frame for a bus, by its name; must not call this object.
    """

    def __init__(self, bus: BusWiring, node: int, timeout: float, send: Callable[[str, Frame], None]) -> None:
        self.booted_after: float | None = None
        self.fault: ArmFault | None = None
        self._link = Link(bus, send, _STUCK_AFTER)
        self._node, self._timeout = node, timeout
        self._begun = 0.0
        self._silent = False

    @property
    def over(self) -> bool:
        """Whether the node has booted, or is not waited for any more."""
        return self._silent or self.booted_after is not None or self.fault is not None

    def start(self, now: float) -> None:
        """Sends the command. The bus is open."""
        self._begun = now
        self._note(self._link.changed("active", "", None, now))
        self._link.queue(Outgoing(cia301.command(Command.RESET_NODE, self._node)), now)

    def receive_event(self, event: Event, now: float) -> None:
        """Takes an event of the bus."""
        if isinstance(event, BusChanged):
            self._note(self._link.changed(event.state, event.why, event.errors, now))
        elif isinstance(event, FrameEchoed) and self._link.echoed(event.frame, now):
            return
        elif isinstance(event, FrameEchoed | FrameReceived) and event.frame == cia301.heartbeat(
            self._node, State.BOOT_UP
        ):
            self.booted_after = now - self._begun

    def send_failed(self, bus: str, frame: Frame, now: float) -> None:
        """Records that a frame could not be sent."""
        self._link.send_failed(frame, now)

    def tick(self, now: float) -> None:
        """Call every millisecond: handles timeouts."""
        self._link.armed = self._link.usable  # so that a stuck bus is found
        self._note(self._link.tick(now, now))
        self._silent = now - self._begun >= self._timeout

    def _note(self, fault: ArmFault | None) -> None:
        self.fault = self.fault or fault


def reset_node(bus: BusWiring, node: int, timeout: float) -> NodeReset:
    """Resets a node; blocks until its boot-up message or the timeout.

    Raises:
        BusError: the bus cannot be opened.
    """
    outbox: list[tuple[str, Frame]] = []
    it = NodeReset(bus, node, timeout, lambda name, frame: outbox.append((name, frame)))
    converse(it, outbox, [CanBus(bus)])
    return it
