"""All arms of the network over one Zenoh session: their messages are taken once, and handed to every open page."""

import asyncio
import logging
import threading
import time
from collections.abc import Callable
from typing import Any

import msgspec
import zenoh

from controller.gateway.client import Client
from controller.panel.arm_view import ArmView
from controller.panel.metrics import Tally
from controller.panel.pages import Page

log = logging.getLogger(__name__)

TICK = 0.05  # [s] between two looks for news
PRESENCE_EVERY, IDLE_EVERY = 0.5, 0.5  # [s]; and between two looks at an arm that no page shows
MOST_ARMS = 256
MOST_PENDING = 1000  # messages that wait for the loop; what comes beyond is dropped
MOST_MESSAGE = 16_000_000  # bytes
KEYS = ("feedback", "result", "diagnostics", "request", "timeline")


class Arms:
    """The arms below a prefix. On the pages' loop, but for Zenoh's callbacks.

    Attributes:
        views: what is known of each arm, by name.
        tally: counts what passes, for metrics.

    Args:
        session: open session.
        prefix: of all keys, "hyperbit", or that of a replay.
    """

    def __init__(self, session: zenoh.Session, prefix: str = "hyperbit") -> None:
        self.views: dict[str, ArmView] = {}
        self.tally = Tally()
        self._session, self._prefix = session, prefix
        self._loop = asyncio.get_running_loop()
        self._pages: set[Page] = set()
        self._latest: dict[str, tuple[bytes, float]] = {}  # states that the loop has not taken, and when they came
        self._pending, self._lock = 0, threading.Lock()
        liveliness = session.liveliness()
        self._declared: list[Any] = [
            session.declare_subscriber(f"{prefix}/*/state", self._on_state),
            *(session.declare_subscriber(f"{prefix}/*/{key}", self._on_message) for key in KEYS),
            liveliness.declare_subscriber(f"{prefix}/*/alive", self._on_alive, history=True),
        ]
        self._task = self._loop.create_task(self._run())

    async def close(self) -> None:
        """Ends the subscriptions."""
        self._task.cancel()
        while self._declared:
            await asyncio.to_thread(self._declared.pop().undeclare)
        for view in self.views.values():
            view.close()

    def known(self) -> list[ArmView]:
        """Returns the arms that were heard of."""
        return [view for view in self.views.values() if view.known]

    def open(self, page: Page, name: str | None) -> ArmView | None:
        """Adds a page on an arm, or on the list of all arms; returns the arm."""
        if name is None:
            self._pages.add(page)
            page.offer("arms", self._list())
            return None
        view = self._view(name)
        if view is not None:
            view.open(page)
        return view

    def shut(self, page: Page, view: ArmView | None) -> None:
        """Removes a page."""
        self._pages.discard(page)
        if view is not None:
            view.shut(page)
            if not view.known and not view.pages:
                del self.views[view.name]  # a name that somebody made up

    # --- from Zenoh's threads

    def _on_state(self, sample: zenoh.Sample) -> None:
        if (name := self._name(sample)) is not None:
            self._latest[name] = sample.payload.to_bytes(), time.monotonic()

    def _on_message(self, sample: zenoh.Sample) -> None:
        name = self._name(sample)
        if name is None or len(sample.payload) > MOST_MESSAGE:
            return
        key, data = str(sample.key_expr).rpartition("/")[2], sample.payload.to_bytes()
        self._hand_over(lambda: self._heard(name, key, data))

    def _on_alive(self, sample: zenoh.Sample) -> None:
        if (name := self._name(sample)) is not None:
            alive = sample.kind == zenoh.SampleKind.PUT
            self._hand_over(lambda: self._told_alive(name, alive))

    def _name(self, sample: zenoh.Sample) -> str | None:
        """Returns the arm that a sample is of; None if its key is not one of an arm."""
        parts = str(sample.key_expr)[len(self._prefix) + 1 :].split("/")
        return parts[0] if len(parts) == 2 and valid(parts[0]) else None

    def _hand_over(self, act: Callable[[], None]) -> None:
        """Has the loop act, unless too much waits for it already."""
        with self._lock:
            if self._pending >= MOST_PENDING:
                return
            self._pending += 1

        def now() -> None:
            with self._lock:
                self._pending -= 1
            act()

        self._loop.call_soon_threadsafe(now)

    # --- on the loop

    def _view(self, name: str) -> ArmView | None:
        """Returns what is known of an arm; None if there are too many."""
        if name not in self.views:
            if len(self.views) >= MOST_ARMS or not valid(name):
                return None
            self.views[name] = ArmView(name, Client(self._session, name, prefix=self._prefix), self._loop)
        return self.views[name]

    def _heard(self, name: str, key: str, data: bytes) -> None:
        if (view := self._view(name)) is None:
            return
        try:
            message = msgspec.json.decode(data, type=dict[str, Any])
        except (msgspec.MsgspecError, RecursionError):
            log.warning("arm %s: a message on %s is not JSON", name, key)
            return
        if key == "result":
            self.tally.result(name, message)
        view.hear(key, message)

    def _told_alive(self, name: str, alive: bool) -> None:
        if (view := self._view(name)) is not None:
            view.hear_alive(alive)

    async def _run(self) -> None:
        presence = 0.0
        while True:
            now = time.monotonic()
            told = now - presence >= PRESENCE_EVERY
            presence = now if told else presence
            for name in list(self._latest):
                if (view := self._view(name)) is None:
                    del self._latest[name]
                elif view.pages or told:
                    try:
                        view.hear_state(*self._latest.pop(name))
                        self.tally.state(name, view.state or {})
                    except Exception:
                        log.exception("arm %s: a state is not understood", name)
            if told:
                for view in self.views.values():
                    view.tell_presence(now)
                if self._pages:
                    listed = self._list()
                    for page in self._pages:
                        page.offer("arms", listed)
            await asyncio.sleep(TICK)

    def _list(self) -> bytes:
        now = time.monotonic()
        known = sorted((view.summary(now) for view in self.known()), key=lambda told: str(told["name"]))
        return msgspec.json.encode({"section": "arms", "arms": known})


def valid(name: str) -> bool:
    """Returns whether a text may be an arm's name."""
    return 0 < len(name) <= 64 and name.isascii() and name.replace("-", "a").replace("_", "a").isalnum()
