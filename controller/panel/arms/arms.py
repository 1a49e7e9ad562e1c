"""All arms of the network over one Zenoh session, which serves all open pages."""

import asyncio
import logging
import threading
import time
from collections.abc import Callable
from typing import Any

import msgspec
import zenoh
from msgspec import Struct

from hyperbit.controller.decoding.decoding import Unreadable, decode
from hyperbit.controller.messages.goals import Result
from hyperbit.controller.messages.reading import MESSAGES, UnreadCount
from hyperbit.controller.messages.state import State
from hyperbit.controller.network.client import Client
from hyperbit.controller.network.fleet import is_name
from hyperbit.controller.network.reach import NoSession
from hyperbit.controller.panel.arms.arm_view import ArmView
from hyperbit.controller.panel.arms.metrics import Counters
from hyperbit.controller.panel.arms.pages import Page

log = logging.getLogger(__name__)

TICK = 0.05  # [s] between two updates from the received states
MISSING_EVERY = 3.0  # [s] between two looks for endpoints without connection
PRESENCE_EVERY = 0.5  # [s] between two updates of presence, and of arms that no page shows
MOST_ARMS = 256  # further arms take the places of gone arms
MOST_ALIVE = 10_000  # names of live daemons; some may have no place yet
GONE_SHOWN = 600.0  # [s] for which a gone arm stays in the list
MOST_PENDING = 1000  # messages that wait for the loop; further messages are dropped
MOST_MESSAGE = 2_000_000  # bytes
KEYS = ("feedback", "result", "diagnostics")  # of a daemon, beside `state`
REPLAY_KEYS = ("request", "timeline")  # of a replay


class Arms:
    """The arms below a prefix. Used on the event loop of the pages, except for Zenoh's callbacks.

    Args:
        prefix: of all keys.
        missing: returns why the session has no connection to some of its endpoints.
        replay: whether the keys are those of a recording. On the keys of a daemon nobody may publish a `timeline`.
    """

    def __init__(
        self, session: zenoh.Session, prefix: str, missing: Callable[[], list[NoSession]], *, replay: bool = False
    ) -> None:
        self.views: dict[str, ArmView] = {}
        self.counters = Counters()  # counts results and faults, for metrics
        self.session, self._prefix = session, prefix
        self._loop = asyncio.get_running_loop()
        self._pages: set[Page] = set()
        self.alive = set[str]()  # names whose liveliness token exists
        self._latest: dict[str, tuple[bytes, float]] = {}  # unprocessed states with times of arrival [s]
        self._unread = UnreadCount()
        self._pending, self._lock = 0, threading.Lock()
        liveliness = session.liveliness()
        keys = (*KEYS, *(REPLAY_KEYS if replay else ()))
        self._declared: list[Any] = [
            session.declare_subscriber(f"{prefix}/*/state", self._on_state),
            *(session.declare_subscriber(f"{prefix}/*/{key}", self._on_message) for key in keys),
            liveliness.declare_subscriber(f"{prefix}/*/alive", self._on_alive, history=True),
        ]
        self._missing: list[dict[str, str]] = []  # sentences on the endpoints without connection
        self._tasks = [self._loop.create_task(it) for it in (self._run(), self._look_for_missing(missing))]

    async def close(self) -> None:
        for task in self._tasks:
            task.cancel()
        while self._declared:
            await asyncio.to_thread(self._declared.pop().undeclare)
        for view in self.views.values():
            view.cancel_request()

    def known(self) -> list[ArmView]:
        """Returns the arms that have sent a message."""
        return [view for view in self.views.values() if view.known]

    def open(self, page: Page, name: str | None) -> ArmView | None:
        """Adds a page of an arm, or of the list of arms if `name` is None; returns the arm."""
        if name is None:
            self._pages.add(page)
            page.offer("arms", self._list())
            return None
        view = self._view(name, shown=True)
        if view is not None:
            view.open(page)
        return view

    def client(self, name: str) -> Client:
        return Client(self.session, name, prefix=self._prefix)

    def shut(self, page: Page, view: ArmView | None) -> None:
        self._pages.discard(page)
        if view is not None:
            view.shut(page)
            if not view.known and not view.pages:
                self._drop(view)  # no arm has this name

    # --- called by Zenoh's threads

    def _on_state(self, sample: zenoh.Sample) -> None:
        if (name := self._name(sample)) is not None and len(sample.payload) <= MOST_MESSAGE:
            self._latest[name] = sample.payload.to_bytes(), time.monotonic()

    def _on_message(self, sample: zenoh.Sample) -> None:
        name = self._name(sample)
        if name is None or len(sample.payload) > MOST_MESSAGE:
            return
        key, data = str(sample.key_expr).rpartition("/")[2], sample.payload.to_bytes()
        self._schedule(lambda: self._on_payload(name, key, data))

    def _on_alive(self, sample: zenoh.Sample) -> None:
        if (name := self._name(sample)) is not None:
            alive = sample.kind == zenoh.SampleKind.PUT
            self._schedule(lambda: self._on_liveliness(name, alive))

    def _name(self, sample: zenoh.Sample) -> str | None:
        """Returns the name of a sample's arm; None if the key belongs to no arm."""
        parts = str(sample.key_expr)[len(self._prefix) + 1 :].split("/")
        return parts[0] if len(parts) == 2 and is_name(parts[0]) else None

    def _schedule(self, act: Callable[[], None]) -> None:
        """Schedules a call on the loop; drops it if too many calls wait."""
        with self._lock:
            if self._pending >= MOST_PENDING:
                return
            self._pending += 1

        def now() -> None:
            with self._lock:
                self._pending -= 1
            act()

        self._loop.call_soon_threadsafe(now)

    # --- called on the loop

    def _view(self, name: str, *, shown: bool = False) -> ArmView | None:
        """Returns the data of an arm, created if it is new; None if there are too many arms.

        An arm that a page shows also takes the place of an arm that no page shows.
        """
        if name not in self.views:
            if not is_name(name) or (len(self.views) >= MOST_ARMS and not self._drop_longest_silent(shown=shown)):
                return None
            view = self.views[name] = ArmView(name, self.client(name), self._loop, self._unread)
            if name in self.alive:
                view.hear_alive(True)
        return self.views[name]

    def _drop(self, view: ArmView) -> None:
        view.cancel_request()
        self.counters.drop_arm(view.name)
        del self.views[view.name]

    def _drop_longest_silent(self, *, shown: bool) -> bool:
        """Drops the longest silent of the arms that are gone, if `shown` of those without a page; returns success."""
        now = time.monotonic()
        found = [view for view in self.views.values() if (not view.pages if shown else not view.present)]
        if found:
            self._drop(max(found, key=lambda view: view.silence(now)))
        return bool(found)

    def _on_payload(self, name: str, key: str, data: bytes) -> None:
        if (view := self._view(name)) is None:
            return
        try:
            self._accept(view, decode(data, MESSAGES[key]))
        except Unreadable as error:
            self._unread.add(name, key, error)

    def _accept(self, view: ArmView, message: Struct) -> None:
        if isinstance(message, Result):
            if message.repeated and view.history.has_result(message.id):
                return
            self.counters.result(view.name, message)
        view.hear(message)

    def _on_liveliness(self, name: str, alive: bool) -> None:
        known = self.views.get(name)
        if not alive:
            self.alive.discard(name)
        elif len(self.alive) < MOST_ALIVE:
            self.alive.add(name)
        if known is not None:
            known.hear_alive(alive)
        elif alive:
            self._view(name)

    def hear_states(self, *, due: bool) -> None:
        """Accepts the latest states of arms that a page shows, and if `due` those of all arms."""
        for name in list(self._latest):
            if (view := self._view(name)) is None:
                del self._latest[name]
            elif view.pages or due:
                data, at = self._latest.pop(name)
                try:
                    view.hear_state(decode(data, State), at)
                except Unreadable as error:
                    self._unread.add(name, "state", error)
                except Exception:
                    log.exception("arm %s: a state is not shown", name)
                else:
                    if view.state is not None:
                        self.counters.state(name, view.state)

    async def _run(self) -> None:
        presence = 0.0
        while True:
            now = time.monotonic()
            due = now - presence >= PRESENCE_EVERY
            presence = now if due else presence
            self.hear_states(due=due)
            if due:
                for view in list(self.views.values()):
                    if not view.present and view.silence(now) > GONE_SHOWN:
                        self._drop(view)
                    view.publish_presence(now, self._missing)
                if self._pages:
                    listed = self._list()
                    for page in self._pages:
                        page.offer("arms", listed)
            await asyncio.sleep(TICK)

    async def _look_for_missing(self, missing: Callable[[], list[NoSession]]) -> None:
        """Looks for the causes while a page is open: a program that is asked again and again may log it."""
        while True:
            if self._pages or any(view.pages for view in self.views.values()):
                try:
                    found = await asyncio.to_thread(missing)
                    self._missing = [{"message": str(why), "advice": why.step} for why in found]
                except Exception:
                    log.exception("the missing connections are not known")
            await asyncio.sleep(MISSING_EVERY)

    def _list(self) -> bytes:
        now = time.monotonic()
        known = sorted((view.summary(now) for view in self.known()), key=lambda entry: str(entry["name"]))
        return msgspec.json.encode({"section": "arms", "arms": known, "missing": self._missing})
