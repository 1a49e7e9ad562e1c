"""What the panel knows of one arm, and shows on every page of it."""

import asyncio
import logging
import math
import time
from typing import Any

import msgspec

from controller.gateway.client import Client, Unanswered
from controller.panel.drawing import Drawing, cloud, picture
from controller.panel.faults import advice
from controller.panel.pages import Control, Page
from controller.panel.record import Record

log = logging.getLogger(__name__)

Message = dict[str, Any]

ASK_AGAIN = 2.0  # [s] after an arm did not answer
SHOWN = (  # of the payload of `arm`
    *("name", "version", "dimension", "length", "base", "actuators", "states", "tolerance", "travel_time", "rest_time"),
    *("inrush", "method", "on_stop", "on_loss", "obstacles", "sent_obstacles", "body_radius", "limits", "daemon"),
)


class ArmView:
    """One arm. On the pages' loop.

    Attributes:
        name: of the arm.
        client: asks its daemon.
        known: whether anything was heard of it.
        pages: that are open on it.
        control: who commands it.
        record: its past.
        drawing: its structure; None until the daemon has told it.
        background: content type and bytes of its density; None likewise.
        state: the latest payload of `state`; None before the first.
        diagnostics: of `diagnostics`, likewise.
        alive: whether the daemon's token is there.
    """

    def __init__(self, name: str, client: Client, loop: asyncio.AbstractEventLoop) -> None:
        self.name, self.client, self.known, self.alive = name, client, False, False
        self.pages: set[Page] = set()
        self.control, self.record = Control(), Record()
        self.drawing: Drawing | None = None
        self.background: tuple[str, bytes] | None = None
        self.state: Message | None = None
        self.diagnostics: Message | None = None
        self._loop, self._heard = loop, -math.inf
        self._sections: dict[str, bytes] = {}
        self._arm: Message = {}
        self._positions: tuple[Any, ...] = ()
        self._asking: asyncio.Task[None] | None = None
        self._wanted, self._again = set[str](), False

    @property
    def actuators(self) -> list[str]:
        """Labels of its actuators; empty until the daemon has told them."""
        return list(self._arm.get("actuators") or ())

    def close(self) -> None:
        """Ends what is asked."""
        if self._asking is not None:
            self._asking.cancel()

    def open(self, page: Page) -> None:
        """Shows a page all there is."""
        self.pages.add(page)
        self.publish_record()
        for section, data in self._sections.items():
            page.offer(section, data)
        self.tell_presence(time.monotonic())

    def shut(self, page: Page) -> None:
        """Forgets a page."""
        self.pages.discard(page)
        if self.control.release(page):
            self.record.say(f"{page.person.name} gave control up")
            self.publish_record()

    def publish(self, section: str, content: Message) -> None:
        """Hands the latest content of a section to all pages."""
        data = msgspec.json.encode({"section": section, **content}, enc_hook=str)
        if self._sections.get(section) == data:
            return
        self._sections[section] = data
        for page in self.pages:
            page.offer(section, data)

    def publish_record(self) -> None:
        """Shows goals, log and curves as they are now."""
        self.publish("goals", {"goals": list(self.record.goals)})
        self.publish("log", {"lines": list(self.record.lines)})
        self.publish("curves", {"errors": list(self.record.errors), "lateness": list(self.record.lateness)})

    def summary(self, now: float) -> Message:
        """Returns what the list of arms shows."""
        state = self.state or {}
        return {
            "name": self.name,
            "alive": self.alive,
            "age": self._age(now),
            "mode": state.get("mode"),
            "reason": state.get("reason"),
        }

    def tell_presence(self, now: float) -> None:
        """Says how long nothing was heard, and who is in control."""
        told = {"section": "presence", "alive": self.alive, "age": self._age(now), "pages": len(self.pages)}
        for page in self.pages:
            control = self.control.told(page)
            page.offer("presence", msgspec.json.encode({**told, "control": control, "you": page.number}))

    def _age(self, now: float) -> float | None:
        return None if self._heard == -math.inf else round(now - self._heard, 2)

    # --- what the daemon tells

    def hear_alive(self, alive: bool) -> None:
        """Takes the arm's liveliness."""
        if alive != self.alive:
            self.record.say("the daemon is there" if alive else "the daemon is gone", "note" if alive else "fault")
            self.publish_record()
        self.alive, self.known = alive, True
        if alive:  # maybe another daemon, with another file
            self._ask("drawing", "density", "running")
        self.tell_presence(time.monotonic())

    def hear_state(self, data: bytes, at: float) -> None:
        """Takes a state that came at a time [s]."""
        told: Message = msgspec.json.decode(data, type=dict[str, Any])
        before, self.state, self._heard, self.known = self.state, told, at, True
        if before is None or (told.get("goal"), told.get("obstacles")) != (before.get("goal"), before.get("obstacles")):
            self._ask("running", *(() if self.drawing else ("drawing", "density")))
        if self.record.state(told):
            self.publish_record()
        faults = [{**fault, "advice": advice(str(fault.get("code")))} for fault in told.get("faults", ())]
        shown = {name: value for name, value in told.items() if name != "stamp"}
        self.publish("state", {**shown, "faults": faults, "error": away(told)})
        self._draw(told)

    def hear(self, key: str, told: Message) -> None:
        """Takes another message."""
        if key == "feedback":
            self.record.feedback(told)
        elif key == "result":
            self.record.result(told)
        elif key == "request":
            self.record.request(told)
        elif key == "diagnostics":
            self.diagnostics = told
            self.record.diagnostics(told)
            self.publish("diagnostics", told)
        elif key == "timeline":
            self._heard = time.monotonic()  # a paused replay publishes no state
            self.publish("timeline", told)
            return
        self.publish_record()

    def _draw(self, told: Message) -> None:
        """Draws the arm where it is commanded and measured to be, if that is elsewhere than before."""
        positions = told.get("commanded"), told.get("measured")
        if self.drawing is None or positions == self._positions:
            return
        commanded, measured = positions
        drawn = [
            None if commanded is None else self.drawing.of_actuators(commanded),
            None if measured is None else self.drawing.of_actuators(measured, commanded or ()),
        ]
        self._positions = positions
        self.publish("bodies", {"commanded": drawn[0], "measured": drawn[1]})

    # --- what the panel asks the daemon

    def _ask(self, *wanted: str) -> None:
        """Asks for the arm's description, with what is wanted besides; one question at a time."""
        self._wanted.update(wanted)
        self._again = True
        if self._asking is None or self._asking.done():
            self._asking = self._loop.create_task(self._answer())

    async def _answer(self) -> None:
        """Asks until there is an answer to all that is wanted, or the daemon is gone."""
        while self._again:
            self._again, wanted = False, set(self._wanted)
            try:
                self._describe(await asyncio.to_thread(self.client.request, "arm", {"with": sorted(wanted)}))
                self._wanted -= wanted
                continue
            except Unanswered as error:
                log.info("arm %s: %s", self.name, error)
            except Exception:
                log.exception("arm %s: its description is not understood", self.name)
            self._again = self.alive  # else asked again when it is there
            await asyncio.sleep(ASK_AGAIN)

    def _describe(self, told: Message) -> None:
        if "drawing" in told:
            drawing = Drawing(told)
            self.drawing, self._positions = drawing, ()
            self._arm["lines"] = drawing.lines
        if (density := told.get("density")) is not None:
            planar = told["dimension"] == 2
            data = picture(density) if planar else msgspec.json.encode(cloud(density))
            self.background = ("image/png" if planar else "application/json"), data
            self._arm["density"] = {name: density[name] for name in ("shape", "first", "pixel")}
        if "running" in told:
            self.publish("waypoints", told["running"] or {"goal": None, "waypoints": []})
        self._arm.update({name: told.get(name) for name in SHOWN})
        self.publish("arm", self._arm)
        if self.state is not None:
            self._draw(self.state)


def away(state: Message) -> float | None:
    """Returns how far the tip is from where the goal wants it now; None if either is unknown."""
    tip, target = state.get("tip"), state.get("target")
    if not tip or not target:
        return None
    shift = state.get("bias") or [0.0] * len(tip["position"])
    seen = [x + s for x, s in zip(tip["position"], shift, strict=False)]
    return math.dist(seen, target["position"]) if len(seen) == len(target["position"]) else None
