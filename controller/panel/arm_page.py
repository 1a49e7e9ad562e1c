"""Requests of pages: checks role, age, control and rate, then sends the request to the daemon from a thread."""

import asyncio
import logging
import secrets
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import msgspec

from hyperbit.controller.armfile.goal_files import parse_goal_file
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.network.client import Unanswered
from hyperbit.controller.panel.arms.arm_view import ArmView
from hyperbit.controller.panel.arms.faults import on_page
from hyperbit.controller.panel.arms.pages import Page, RateLimit
from hyperbit.controller.panel.requests import (
    AgainRequest,
    AnswerRequest,
    CancelRequest,
    ControlRequest,
    FaultRequest,
    FreeRequest,
    GoalFileRequest,
    GoalRequest,
    JogRequest,
    LockRequest,
    ObstaclesRequest,
    PageRequest,
    PlanRequest,
    PoseRequest,
    ReleaseControlRequest,
    ResetRequest,
    SeekRequest,
    StopRequest,
    TakeControlRequest,
    UrgentRequest,
)
from hyperbit.controller.refusals.reasons import advice

log = logging.getLogger(__name__)

Message = dict[str, Any]

RATE, AT_ONCE = 10.0, 20.0  # requests of one page [1/s], and in a burst
STOPS, STOPS_AT_ONCE = 10.0, 10.0  # the same for stops and cancels
MOST_REFUSED = 200  # a page is closed after this number of consecutive refusals for rate
MOST_OPEN = 4  # unanswered requests of one page
PLAN_WITHIN = 15.0  # [s]
MOST_YAML = 50_000  # characters


class RequestThreads:
    """The threads that send requests to daemons. Stops have their own threads, so that they never wait."""

    def __init__(self) -> None:
        self.stops = ThreadPoolExecutor(32, "stop")  # pages ask a silent daemon again and again
        self.plans = ThreadPoolExecutor(4, "plan")
        self.others = ThreadPoolExecutor(8, "ask")

    def close(self) -> None:
        """Ends each thread after its present answer."""
        for pool in (self.stops, self.plans, self.others):
            pool.shutdown(wait=False, cancel_futures=True)


class Flood(Exception):
    """A page sends far too many requests."""


class ArmPage:
    """Serves the requests of one page. Used only on the event loop of the pages."""

    def __init__(self, view: ArmView, page: Page, threads: RequestThreads) -> None:
        self._view, self._page, self._threads = view, page, threads
        self._limit, self._stops = RateLimit(RATE, AT_ONCE), RateLimit(STOPS, STOPS_AT_ONCE)
        self._open: set[asyncio.Task[None]] = set()

    def receive_request(self, request: PageRequest) -> None:
        """Accepts a request; its answer is sent to the page. Raises Flood if the page sent too many requests."""
        urgent = isinstance(request, UrgentRequest)
        limit = self._stops if urgent else self._limit
        if not limit.take_token():
            if limit.refused > MOST_REFUSED:
                raise Flood
            self._refuse(request, "too many requests: wait a second")
        elif (refusal := self._refusal(request)) is not None:
            self._refuse(request, refusal)
        elif not urgent and len(self._open) >= MOST_OPEN:
            self._refuse(request, "earlier requests are not answered yet: wait")
        else:
            task = asyncio.get_running_loop().create_task(self._serve(request))
            self._open.add(task)
            task.add_done_callback(self._open.discard)

    def refuse(self, number: int, message: str) -> None:
        self._page.reply(encoded({"section": "reply", "n": number, "accepted": False, "message": message}))

    def _refuse(self, request: PageRequest, message: str) -> None:
        self.refuse(request.n, message)

    def _refusal(self, request: PageRequest) -> str | None:
        """Returns why the page may not send this request, or None; the first page that commands gets control."""
        person = self._page.person
        if person.role != "operator" and not (person.may_stop and isinstance(request, StopRequest)):
            return f"{person.name} may {'look and stop' if person.may_stop else 'look'}, not command"
        if isinstance(request, FreeRequest):
            return None
        late = self._page.heartbeats.refusal(request.heartbeat)
        if late is not None:
            self._say(f"sent a command, refused: {late}")  # the page may be closed
            return late
        return self._view.control.refusal(self._page)

    async def _serve(self, request: PageRequest) -> None:
        try:
            answer = await self._carry_out(request)
        except Unanswered as error:
            answer = {"accepted": False, "message": str(error)}
        except InputFaults as error:
            answer = {"accepted": False, "message": "; ".join(error.faults)}
        except Exception:
            log.exception("arm %s: a request failed", self._view.name)
            answer = {"accepted": False, "message": "internal error, see the panel's journal"}
        advised = {"advice": on_page(advice(answer["reason"], self._view.name))} if "reason" in answer else {}
        self._page.reply(encoded({"section": "reply", "n": request.n, **answer, **advised}))

    async def _carry_out(self, request: PageRequest) -> Message:
        match request:
            case StopRequest():
                return await self._command(request, "stop", {})
            case CancelRequest():
                return await self._command(request, "cancel", {})
            case ResetRequest():
                return await self._command(request, "reset", {})
            case JogRequest(actuator=actuator, state=state):
                return await self._command(request, "jog", {"actuators": {actuator: state}})
            case LockRequest(actuator=actuator, state=at):
                return await self._command(request, "degrade", {"actuator": actuator, "state": at})
            case ObstaclesRequest(regions=regions):
                return await self._command(request, "obstacles", {"regions": regions})
            case FaultRequest(fault=fault):
                return await self._command(request, "fault", {"fault": fault})
            case AnswerRequest(question=question, answer=key):
                seen = self._view.state
                stamp = 0.0 if seen is None else seen.stamp  # its sender tells by it how old the answer is
                return await self._command(request, "answer", {"question": question, "answer": key, "stamp": stamp})
            case PoseRequest(save=save, goal=goal, remove=remove):
                change = {"save": save, "goal": goal, "remove": remove}
                answer = await self._command(request, "poses", {k: v for k, v in change.items() if v is not None})
                self._view.describe_again()
                return answer
            case GoalRequest(goal=goal):
                named = {**goal, "id": f"{self._page.person.name}-{secrets.token_hex(3)}"}
                answer = await self._command(request, "goal", named)
                if answer.get("accepted"):
                    self._view.history.sent(str(answer.get("id")), goal)
                    self._view.publish_history()
                return answer
            case PlanRequest(goal=goal):
                return await self._plan(goal)
            case GoalFileRequest(text=text, name=name):
                words = text, Path(name), MOST_YAML
                read = await asyncio.get_running_loop().run_in_executor(self._threads.plans, parse_goal_file, *words)
                return {**await self._plan(read), "file": read}
            case AgainRequest(id=name):
                sent = self._view.history.goal_of(name)
                if sent is None:
                    return {"accepted": False, "message": f"the panel does not have the goal {name} any more"}
                return {**await self._plan(sent), "file": sent}
            case SeekRequest():
                asked = {"at": request.at, "speed": request.speed, "paused": request.paused}
                changed = {k: v for k, v in asked.items() if v is not None}
                loop, client = asyncio.get_running_loop(), self._view.client
                return await loop.run_in_executor(self._threads.others, client.request, "timeline", changed)
            case TakeControlRequest():
                self._view.control.take_control(self._page)
                self._say("took control")
                return {"accepted": True, "message": "you have control"}
            case ReleaseControlRequest():
                if self._view.control.release_control(self._page):
                    self._say("released control")
                return {"accepted": True, "message": "nobody has control"}

    async def _command(self, request: UrgentRequest | ControlRequest, key: str, payload: Message) -> Message:
        """Sends a request that changes something, and logs the person."""
        loop = asyncio.get_running_loop()
        pool = self._threads.stops if isinstance(request, UrgentRequest) else self._threads.others
        answer = await loop.run_in_executor(pool, self._send, request, key, payload)
        accepted = "" if answer.get("accepted") else ", refused"
        self._say(f"asked for {key}{accepted}: {answer.get('message')}")
        return answer

    def _send(self, request: UrgentRequest | ControlRequest, key: str, payload: Message) -> Message:
        """Sends a request to the daemon, unless it waited too long for a thread. Called by that thread."""
        if not isinstance(request, UrgentRequest):
            late = self._page.heartbeats.refusal(request.heartbeat)
            if late is not None:
                return {"accepted": False, "message": late}
        return self._view.client.request(key, payload)

    async def _plan(self, goal: Message) -> Message:
        """Returns the daemon's plan of a goal, with the line segments of each waypoint."""
        loop, client = asyncio.get_running_loop(), self._view.client
        answer = await loop.run_in_executor(self._threads.plans, client.request, "plan", goal, PLAN_WITHIN)
        drawing = self._view.drawing
        if drawing is not None:
            for point in answer.get("waypoints", ()):
                point["body"] = None if point.get("between") else drawing.of_text(point["configuration"])
        return answer

    def _say(self, what: str) -> None:
        log.info("arm %s: %s %s", self._view.name, self._page.person.name, what)
        self._view.history.say(f"{self._page.person.name} {what}")
        self._view.publish_history()


def encoded(message: Mapping[str, Any]) -> bytes:
    return msgspec.json.encode(message)
