"""State and diagnostics on their way out: the latest of each, by a thread of its own, dropped for a slow peer."""

import logging
import threading
from collections.abc import Callable

import zenoh

from controller.daemon.events import Payload
from controller.daemon.messages import encode
from controller.daemon.state import Diagnostics, Snapshot, diagnostics_payload, state_payload
from controller.manipulator.manipulator import Manipulator

log = logging.getLogger(__name__)


class Publisher:
    """Publishes what the control loop shows; only the latest waits.

    Args:
        session: open session.
        prefix: of all keys, "hyperbit/<arm>".
        manipulator: to reckon the tip from measured states.
        outbox: returns how many messages wait there.
        planning: returns how many goals wait to be planned.
        setpoint: returns how the stream of setpoints fares.
        real_time: returns "on", "off" or what is missing.
        bias: returns what `state` tells of the tip's bias, nothing where it is not measured.
        tracker: returns what diagnostics tell of its estimate, likewise.
    """

    def __init__(
        self,
        session: zenoh.Session,
        prefix: str,
        manipulator: Manipulator,
        outbox: Callable[[], int],
        planning: Callable[[], int],
        setpoint: Callable[[], Payload],
        real_time: Callable[[], str],
        bias: Callable[[], Payload] = dict,
        tracker: Callable[[], Payload] = dict,
    ) -> None:
        drop, json = zenoh.CongestionControl.DROP, zenoh.Encoding.APPLICATION_JSON
        self._state = session.declare_publisher(f"{prefix}/state", encoding=json, congestion_control=drop)
        self._diagnostics = session.declare_publisher(f"{prefix}/diagnostics", encoding=json, congestion_control=drop)
        self._manipulator, self._outbox, self._planning, self._setpoint = manipulator, outbox, planning, setpoint
        self._real_time, self._bias, self._tracker = real_time, bias, tracker
        self._news = threading.Condition()
        self._latest: Snapshot | None = None
        self._latest_diagnostics: Diagnostics | None = None
        self._closing = False
        self._thread = threading.Thread(target=self._run, name="telemetry", daemon=True)
        self._thread.start()

    def show(self, snapshot: Snapshot) -> None:
        """Takes the latest state."""
        with self._news:
            self._latest = snapshot
            self._news.notify()

    def diagnose(self, diagnostics: Diagnostics) -> None:
        """Takes the latest diagnostics."""
        with self._news:
            self._latest_diagnostics = diagnostics
            self._news.notify()

    def close(self, timeout: float = 1.0) -> None:
        """Publishes the last state and ends the thread."""
        with self._news:
            self._closing = True
            self._news.notify()
        self._thread.join(timeout)

    def _run(self) -> None:
        while True:
            with self._news:
                self._news.wait_for(lambda: self._latest or self._latest_diagnostics or self._closing)
                state, diagnostics = self._latest, self._latest_diagnostics
                self._latest = self._latest_diagnostics = None
            if state is None and diagnostics is None:
                return
            try:
                if state is not None:
                    self._state.put(encode({**state_payload(self._manipulator, state), **self._bias()}))
                if diagnostics is not None:
                    payload = diagnostics_payload(diagnostics, self._outbox(), self._planning(), self._setpoint())
                    payload = {**payload, "real_time": self._real_time(), **self._tracker()}
                    self._diagnostics.put(encode(payload))
            except Exception:
                log.exception("telemetry was not sent")
