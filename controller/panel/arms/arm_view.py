"""The panel's data of one arm, which all pages of the arm show."""

import asyncio
import logging
import math
import time
from collections.abc import Sequence
from operator import attrgetter
from typing import Any

import msgspec
from msgspec import UNSET, Struct, to_builtins

from hyperbit.controller.decoding.decoding import OTHER_FORM, convert
from hyperbit.controller.messages.arm import Description, Running
from hyperbit.controller.messages.goals import Feedback, Note, Result
from hyperbit.controller.messages.reading import UnreadCount
from hyperbit.controller.messages.state import Diagnostics, State, Timeline
from hyperbit.controller.network.client import Client, Unanswered
from hyperbit.controller.panel.arms.arm_history import ArmHistory
from hyperbit.controller.panel.arms.drawing import Drawing, cloud, picture
from hyperbit.controller.panel.arms.faults import advised
from hyperbit.controller.panel.arms.pages import Control, Page
from hyperbit.controller.panel.arms.replay_clock import ReplayClock

log = logging.getLogger(__name__)

ASK_AGAIN = 2.0  # [s] after an arm did not answer
SILENT = 5.0  # [s] without a state, after which an arm without liveliness token counts as gone
SHOWN = (  # fields of the payload of `arm` for the page
    *("name", "version", "dimension", "unit", "length", "base", "actuators", "states", "tolerance", "travel_time"),
    *(
        "rest_time",
        "inrush",
        "method",
        "on_stop",
        "on_loss",
        "obstacles",
        "sent_obstacles",
        "body_radius",
        "limits",
        "daemon",
    ),
    *("poses", "simulated", "simulation"),
)

DESCRIBED = attrgetter("goal", "obstacles", "poses", "mode")  # the description changes with these


class ArmView:
    """Data of one arm. Used only on the event loop of the pages.

    `known`: a message of the arm was received; `alive`: its daemon's liveliness token exists.
    """

    def __init__(self, name: str, client: Client, loop: asyncio.AbstractEventLoop, unread: UnreadCount) -> None:
        self.name, self.client, self.known, self.alive = name, client, False, False
        self.pages: set[Page] = set()
        self.control, self.history = Control(), ArmHistory()
        self.drawing: Drawing | None = None  # structure of the arm; None until the daemon has described it
        # content type and bytes of the density; None until the daemon has described it
        self.background: tuple[str, bytes] | None = None
        self.state: State | None = None  # the latest one
        self.diagnostics: Diagnostics | None = None  # the latest ones
        self._unread = unread
        self._loop, self._heard, self._liveliness = loop, -math.inf, time.monotonic()
        self._sections: dict[str, bytes] = {}
        self._arm: dict[str, Any] = {}
        self._replay: ReplayClock | None = None  # of a replayed recording
        self._positions: tuple[Any, ...] = ()
        self._last_states: list[int | None] = []  # the last known state of each actuator
        self._asking: asyncio.Task[None] | None = None
        self._wanted, self._again = set[str](), False

    @property
    def actuators(self) -> list[str]:
        """Labels of the actuators; empty until the daemon has described the arm."""
        return list(self._arm.get("actuators") or ())

    @property
    def present(self) -> bool:
        """Whether the daemon was heard lately, or a page shows the arm."""
        return self.alive or bool(self.pages) or time.monotonic() - self._heard < SILENT

    def silence(self, now: float) -> float:
        """Returns the time since the last sign of the daemon [s]: a state, or a change of its liveliness."""
        return now - max(self._heard, self._liveliness)

    def cancel_request(self) -> None:
        if self._asking is not None:
            self._asking.cancel()

    def open(self, page: Page) -> None:
        self.pages.add(page)
        self.publish_history()
        for section, data in self._sections.items():
            page.offer(section, data)
        self.publish_presence(time.monotonic())

    def shut(self, page: Page) -> None:
        """Removes a page; the page loses control."""
        self.pages.discard(page)
        if self.control.release_control(page):
            self.history.say(f"{page.person.name} released control")
            self.publish_history()

    def publish(self, section: str, content: dict[str, Any]) -> None:
        """Sends a section to all pages, if its content has changed."""
        data = msgspec.json.encode({**content, "section": section}, enc_hook=str)
        if self._sections.get(section) == data:
            return
        self._sections[section] = data
        for page in self.pages:
            page.offer(section, data)

    def publish_history(self) -> None:
        self.publish("goals", {"goals": list(self.history.goals)})
        self.publish("log", {"lines": list(self.history.lines)})
        self.publish("curves", {"errors": list(self.history.errors), "lateness": list(self.history.lateness)})

    def summary(self, now: float) -> dict[str, Any]:
        state = self.state
        return {
            "name": self.name,
            "alive": self.alive,
            "age": self._age(now),
            "mode": None if state is None else state.mode,
            "reason": None if state is None else state.reason,
            "simulated": state is not None and state.simulated,
        }

    def publish_presence(self, now: float, missing: Sequence[dict[str, Any]] = ()) -> None:
        """Sends each page stamp and age of the latest state, the page that has control, and missing connections."""
        latest = {"age": self._age(now), "stamp": None if self.state is None else self.state.stamp}
        presence = {"section": "presence", "alive": self.alive, **latest, "pages": len(self.pages), "missing": missing}
        for page in self.pages:
            control = self.control.described()
            page.offer("presence", msgspec.json.encode({**presence, "control": control, "you": page.number}))

    def _age(self, now: float) -> float | None:
        return None if self._heard == -math.inf else round(now - self._heard, 2)

    # --- messages of the daemon

    def hear_alive(self, alive: bool) -> None:
        if alive != self.alive:
            self.history.say("the daemon is there" if alive else "the daemon is gone", "note" if alive else "fault")
            self.publish_history()
        self.alive, self.known, self._liveliness = alive, True, time.monotonic()
        if alive:  # this may be another daemon, with another arm's file
            self._ask("drawing", "density", "running")
        self.publish_presence(time.monotonic())

    def hear_state(self, state: State, at: float) -> None:
        """Accepts a state that arrived at time `at` [s]."""
        changed = self.history.state(state)
        before, self.state, self._heard, self.known = self.state, state, at, True
        if before is None or DESCRIBED(state) != DESCRIBED(before):
            self._ask("running", *(() if self.drawing else ("drawing", "density")))
        if changed:
            self.publish_history()
        shown = to_builtins(state)
        del shown["stamp"]
        self.publish("state", {**shown, "faults": advised(state.faults), "error": target_distance(state)})
        self._draw(state)

    def hear(self, message: Struct) -> None:
        match message:
            case Feedback():
                self.history.feedback(message)
            case Result():
                self.history.result(message)
            case Note():
                self.history.request(message)
            case Diagnostics():
                self.diagnostics = message
                self.publish("diagnostics", to_builtins(message))
                self.history.diagnostics(message)
            case Timeline():  # only of a replay
                self._heard = time.monotonic()  # a paused replay publishes no state
                self._hear_timeline(message)
                self.publish("timeline", to_builtins(message))
                return
        self.publish_history()

    def _hear_timeline(self, timeline: Timeline) -> None:
        if self._replay is None:
            self._replay = ReplayClock()
            self._replay.hear(timeline)
            self.history.set_clock(self._replay)
        elif (moved := self._replay.hear(timeline)) is None:
            return
        elif moved == "back":
            self.history.rewind()
        else:
            self.history.skip()
        self.publish_history()

    def _draw(self, state: State) -> None:
        """Publishes the commanded and the measured shape of the arm, if either has changed.

        Modules of unknown position are drawn as they were last known.
        """
        positions = state.commanded, state.measured
        if self.drawing is None or positions == self._positions:
            return
        count = len(self.drawing.manipulator.actuators)
        commanded, measured = (it if it and len(it) == count else [None] * count for it in positions)
        if len(self._last_states) != count:
            self._last_states = list(commanded)
        self._last_states = [a if b is None else b for a, b in zip(self._last_states, measured, strict=True)]
        bodies = {
            "commanded": self.drawing.of_actuators(commanded),
            "measured": self.drawing.of_actuators(measured, self._last_states),
            "unknown": self.drawing.unknown_modules(measured),
            "last": self._last_states,
        }
        self._positions = positions
        self.publish("bodies", bodies)

    # --- requests to the daemon

    def describe_again(self) -> None:
        """Requests the arm's description, because it has changed."""
        self._ask()

    def _ask(self, *wanted: str) -> None:
        """Requests the arm's description with further parts; one request at a time."""
        self._wanted.update(wanted)
        self._again = True
        if self._asking is None or self._asking.done():
            self._asking = self._loop.create_task(self._answer())

    async def _answer(self) -> None:
        """Repeats the request until all parts are answered, or the daemon is gone."""
        while self._again:
            self._again, wanted = False, set(self._wanted)
            try:
                told = await asyncio.to_thread(self.client.request, "arm", {"with": sorted(wanted)})
                self._describe(convert(told, Description))
                self._wanted -= wanted
                continue
            except Unanswered as error:
                log.info("arm %s: %s", self.name, error)
            except OTHER_FORM as error:
                self._unread.add(self.name, "arm", error)
            self._again = self.alive  # otherwise the request is repeated when the daemon is back
            await asyncio.sleep(ASK_AGAIN)

    def _describe(self, arm: Description) -> None:
        if arm.drawing:
            drawing = Drawing(arm)
            self.drawing, self._positions = drawing, ()
            self._arm["lines"] = drawing.lines
        if density := arm.density:
            planar = arm.dimension == 2
            data = picture(density) if planar else msgspec.json.encode(cloud(density))
            self.background = ("image/png" if planar else "application/json"), data
            self._arm["density"] = {"shape": density.shape, "first": density.first, "pixel": density.pixel}
        if arm.running is not UNSET:
            self.publish("waypoints", to_builtins(arm.running or Running()))
        self._arm.update({name: to_builtins(getattr(arm, name)) for name in SHOWN})
        self.publish("arm", self._arm)
        if self.state is not None:
            self._draw(self.state)


def target_distance(state: State) -> float | None:
    """Returns the distance of the tip, tip bias included, from the present target; None if either is unknown."""
    tip, target = state.tip, state.target
    if tip is None or target is None:
        return None
    bias = state.bias or [0.0] * len(tip.position)
    position = [x + shift for x, shift in zip(tip.position, bias, strict=False)]
    return math.dist(position, target.position) if len(position) == len(target.position) else None
