"""Publishes `state` 20 times a second and on change, and `diagnostics` once a second; notifies systemd."""

import logging
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import msgspec
import zenoh

from controller.gateway.encoding import JSON, encode
from controller.journal import fields_of_fault, message_id
from controller.notify import Notifier
from controller.planning.core.messages import Payload
from controller.program import Fault

log = logging.getLogger(__name__)

STATE_EVERY, DIAGNOSTICS_EVERY = 0.05, 1.0  # [s]
LEAST_GAP = 0.002  # [s] between two states, at least
SILENCE = 1.2 * STATE_EVERY  # [s] without a change until the next `state`; each snapshot is a change


class StatusReporter:
    """A thread that publishes the latest state and diagnostics. A slow peer misses some of them.

    Args:
        session: open session.
        prefix: of all keys, "hyperbit/<arm>".
        state: returns the payload of `state`.
        diagnostics: returns the payload of `diagnostics`.
        changed: other threads set it when the state changes.
        warnings: returns the active warnings that `state` shows beside its own faults.
        outbox: returns the number of messages that wait to be sent.
        notifier: notifies systemd.
    """

    def __init__(
        self,
        session: zenoh.Session,
        prefix: str,
        state: Callable[[], Payload],
        diagnostics: Callable[[], Payload],
        changed: threading.Event,
        warnings: Callable[[], tuple[Fault, ...]],
        outbox: Callable[[], int],
        notifier: Notifier,
    ) -> None:
        drop = zenoh.CongestionControl.DROP
        self._state = session.declare_publisher(f"{prefix}/state", encoding=JSON, congestion_control=drop)
        self._diagnostics = session.declare_publisher(f"{prefix}/diagnostics", encoding=JSON, congestion_control=drop)
        self._of_state, self._of_diagnostics, self._changed = state, diagnostics, changed
        self._warnings, self._outbox, self._notifier = warnings, outbox, notifier
        self._status = ""
        self._faults = set[tuple[str, str]]()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="status-reporter", daemon=True)
        self._thread.start()

    def close(self, timeout: float = 1.0) -> None:
        """Publishes the last state and ends the thread."""
        self._closing.set()
        self._changed.set()
        self._thread.join(timeout)

    def _run(self) -> None:
        due = 0.0
        while not self._closing.is_set():
            self._report()
            if (now := time.monotonic()) >= due:
                due = now + DIAGNOSTICS_EVERY
                self._diagnose()
            self._closing.wait(LEAST_GAP)
            self._changed.wait(SILENCE)
            self._changed.clear()
        self._report()

    def _report(self) -> None:
        try:
            state = self._of_state()
            warnings = self._warnings()
            payload = {**state, "faults": merged(state.get("faults", ()), warnings)}
            self._state.put(encode(payload))
            status = f"{state.get('mode')}: {state.get('reason')}"
            self._log_faults(state.get("faults", ()))
            if status != self._status:
                self._status = status
                self._notifier.send(f"STATUS={status}")
        except Exception:
            log.exception("the state was not published")

    def _log_faults(self, faults: Iterable[Mapping[str, Any]]) -> None:
        """Logs faults when they begin and end; `Warnings` logs its own."""
        active = {(fault["code"], fault["source"]): fault["message"] for fault in faults}
        for (code, source), message in active.items():
            if (code, source) not in self._faults:
                log.error("%s: %s", code, message, extra={"journal": fields_of_fault(code, source)})
        for code, source in self._faults - active.keys():
            fields = {**fields_of_fault(code, source), "MESSAGE_ID": message_id("fault-over")}
            log.info("%s at %s is over", code, source, extra={"journal": fields})
        self._faults = set(active)

    def _diagnose(self) -> None:
        try:
            diagnostics = self._of_diagnostics()
            queues = {**diagnostics.get("queues", {}), "outbox": self._outbox()}
            self._diagnostics.put(encode({**diagnostics, "queues": queues}))
            self._notifier.send("WATCHDOG=1")  # this thread calls all parts of the planner: it hangs if one does
        except Exception:
            log.exception("the diagnostics were not published")


def merged(faults: Iterable[Mapping[str, Any]], warnings: Iterable[Fault]) -> list[Mapping[str, Any]]:
    """Returns the faults, and the warnings that are not among them."""
    result = list(faults)
    known = {(fault["code"], fault["source"]) for fault in result}
    result += [msgspec.structs.asdict(fault) for fault in warnings if (fault.code, fault.source) not in known]
    return result
