"""The table of readers of wires and files. Each takes a key, or a file's name, and bytes that anybody may have sent."""

from __future__ import annotations

import contextlib
import io
import json
import logging
import random
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

import yaml
import zenoh
from msgspec import convert
from rich.console import Console

from hyperbit.controller.arm.arm import load
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands.common import CommandFailed
from hyperbit.controller.commands.connection import ask
from hyperbit.controller.commands.use import fleet as fleet_command
from hyperbit.controller.commands.use import watch as watch_command
from hyperbit.controller.commands.use.obstacles import print_obstacles
from hyperbit.controller.commands.use.poses import print_poses
from hyperbit.controller.commands.use.send import print_result
from hyperbit.controller.gateway.arrivals import Clocks, RepeatedGoals
from hyperbit.controller.gateway.claim import claimant
from hyperbit.controller.gateway.outbox import Outbox
from hyperbit.controller.gateway.poses import Poses
from hyperbit.controller.gateway.server import GatewayParts, Server
from hyperbit.controller.host.files import read_kept
from hyperbit.controller.messages import reading
from hyperbit.controller.messages.state import Diagnostics, State
from hyperbit.controller.network import client as network_client
from hyperbit.controller.network.client import Client, Unanswered
from hyperbit.controller.network.fleet import ArmAddress, Fleet, Presence
from hyperbit.controller.network.stop_all import note
from hyperbit.controller.panel.access.people import read_people
from hyperbit.controller.panel.access.sessions import Session
from hyperbit.controller.planning.core.goal import Context
from hyperbit.controller.planning.core.results import decode_context
from hyperbit.controller.planning.planner import RequestDecoder
from hyperbit.controller.program import Accepted, Malformed, Question, decode_down, decode_up, encode
from hyperbit.controller.ros2.goal_book import GoalBook
from hyperbit.controller.ros2.wire.cdr import serialize
from tests import told
from tests.fuzz import requests
from tests.fuzz.executor import MESSAGES
from tests.fuzz.judge import Flood
from tests.fuzz.mutations import mutated
from tests.fuzz.page import http, page, page_request
from tests.fuzz.recordings import player, read_recording, recorder
from tests.fuzz.still import ROOM, Query, Reply, Sample, StillSession, Take
from tests.gateway.conftest import FakePlanner
from tests.keys import DEPLOY
from tests.ros2.rig import Rig
from tests.ros2.world.inputs import ATTACHMENT, KINDS, TYPES, Input

CORPUS = Path(__file__).with_name("corpus")
MOST_LINES = 60  # of the log, however many inputs there are
AT_ONCE = mock.patch.object(network_client, "PAUSE", 0.0)  # a client asks again without a pause


class Quiet(logging.Handler):
    """A reader whose log is bounded and has no traceback. `starts`: each input is read at a start."""

    def __init__(self, take: Take, *, starts: bool = False) -> None:
        super().__init__(logging.WARNING)
        self._take, self._starts = take, starts
        self.count, self.last, self.traceback = 0, "", ""
        logging.getLogger().addHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        self.count, self.last = self.count + 1, record.getMessage()
        if record.exc_info:
            self.traceback = logging.Formatter().formatException(record.exc_info)

    def __call__(self, key: str, data: bytes) -> None:
        self._take(key, data)
        if self.traceback:
            raise AssertionError(f"a traceback in the log: {self.traceback}")
        if self.count > MOST_LINES:
            raise Flood(f"{self.count} lines of the log, the last: {self.last}")
        self.count *= not self._starts


def daemon() -> Take:
    """The gateway, with the daemon's own decoders of requests."""
    session, goals = StillSession(), RepeatedGoals()
    planner: Any = FakePlanner()
    planner.decoder = RequestDecoder(load(DEPLOY / "planar16.yaml"))
    folder = Path(tempfile.mkdtemp(dir=ROOM))
    outbox = Outbox(session, "hyperbit/a", goals.ended, lambda *_: None, lambda _: None, lambda _: None)  # type: ignore[arg-type]
    parts = GatewayParts(
        planner, outbox, goals, Poses(folder / "p.json", "0"), lambda _: None, Clocks(pause=lambda _: None)
    )
    server = Server(session, "a", parts)  # type: ignore[arg-type]

    def take(key: str, data: bytes) -> None:
        if key == "setpoint":
            session.subscribers[f"hyperbit/a/{key}"](Sample(f"hyperbit/a/{key}", zenoh.ZBytes(data)))
            return
        query = Query(f"hyperbit/a/{key}", data)
        session.queryables[f"hyperbit/a/{key}"](query)
        while outbox.step():
            pass
        while outbox.waiting():
            outbox.step()
        (answer,) = [json.loads(reply) for reply in query.replies]
        assert answer.get("reason") != "internal-error", answer
        assert key == "arm" or (isinstance(answer["accepted"], bool) and answer["message"]), answer

    take.server = server  # type: ignore[attr-defined]
    return take


def fleet() -> Take:
    session = StillSession()
    arms, console = Fleet(session, [ArmAddress("", "planar16")]), Console(file=io.StringIO(), width=200, markup=False)  # type: ignore[arg-type]

    def take(key: str, data: bytes) -> None:
        if key == "arm":
            session.answer = data
            arms._arms[ArmAddress("", "planar16")] = Presence()
            arms.ask()
        elif key == "state":
            session.subscribers["hyperbit/*/state"](Sample("hyperbit/planar16/state", zenoh.ZBytes(data)))
        else:
            note(Reply(Sample("hyperbit/planar16/stop", zenoh.ZBytes(data))), {})  # type: ignore[arg-type]
            return
        (arm,) = arms.arms()
        fleet_command.line_of_arm(arm)
        json.dumps(fleet_command.fields_of(arm))
        if arm.state is not None:
            console.print(fleet_command.view_of([arm], "here", connected=True))
        console.file = io.StringIO()

    return take


def client() -> Take:
    """Answers and messages that commands read and show."""
    session, console = StillSession(), Console(file=io.StringIO(), width=200, markup=False)
    one, view = Client(session, "planar16"), watch_command.View("planar16", (), "")  # type: ignore[arg-type]

    def show(key: str, message: dict[str, Any]) -> None:
        if key == "result":
            print_result({**message, "code": 0}, "planar16", as_json=False, unit="")
        told = convert(message, reading.MESSAGES[key])
        if isinstance(told, State | Diagnostics):
            view.receive_message(told)
        console.print(view)
        console.file = io.StringIO()
        if isinstance(told, State):
            assert watch_command.clock_of(told) + watch_command.line_of(told, "")

    def take(key: str, data: bytes) -> None:
        if key in ("state", "diagnostics", "feedback", "result"):
            one.subscribe(key, partial(show, key))
            sample = Sample(f"hyperbit/planar16/{key}", zenoh.ZBytes(data))
            with contextlib.redirect_stdout(io.StringIO()):
                session.subscribers[f"hyperbit/planar16/{key}"](sample)
            return
        session.answer = data
        with contextlib.suppress(Unanswered, CommandFailed), contextlib.redirect_stdout(io.StringIO()), AT_ONCE:
            if key == "arm":
                described = one.describe()
                print_obstacles(described, as_json=False)
                print_poses(described.poses, as_json=False)
            else:
                ask(one, "planar16", key, {}, as_json=False)

    return take


def bridge() -> Take:
    """What the bridge to ROS 2 reads from the daemon, and from ROS 2."""
    rig = Rig(Path(tempfile.mkdtemp(dir=ROOM)))

    def take(key: str, data: bytes) -> None:
        if key in KINDS:
            rig.deliver(Input(key, data, ATTACHMENT))
            rig.threads.run()
        else:
            rig.hear(key, data, sure=False)

    return take


def packed() -> Take:
    """What the planner reads from the executor, and what it left in a program."""

    def take(key: str, data: bytes) -> None:
        if key == "context":
            decode_context(data)
            return
        with contextlib.suppress(Malformed):
            (decode_up if key == "up" else decode_down)(data)

    return take


def small_files() -> Take:
    """Files beside the daemon and its programs that are read at a start, and what another daemon answers."""
    folder = Path(tempfile.mkdtemp(dir=ROOM))

    def take(name: str, data: bytes) -> None:
        path = folder / name
        path.write_bytes(data)
        match name:
            case "poses":
                Poses(path, "0")
            case "goals":
                GoalBook(path)
            case "sessions":
                read_kept(path, dict[str, Session], "all people must log in")
            case "people":
                with contextlib.suppress(InputFaults):
                    read_people(path)
            case _:
                claimant(data)
        for left in folder.iterdir():
            left.unlink()

    return take


def simply(take: Take) -> Callable[[], Take]:
    return lambda: take


PUBLISHED = {key: [value] for key, value in told.published().items()}
# What builds a reader, and valid inputs of each key: JSON, or bytes.
READERS: dict[str, tuple[Callable[[], Take], dict[str, list[Any]]]] = {
    "request": (
        simply(requests.read_request),
        {
            "goal": [told.GOAL, told.LINE, told.CONFIGURATIONS],
            "jog": [told.JOG],
            "setpoint": [told.SETPOINT],
            "measured_tip": [told.MEASURED_TIP],
            "degrade": [told.DEGRADE],
            "obstacles": [told.OBSTACLES, told.OBSTACLES_IN_SPACE],
        },
    ),
    "arm": (
        simply(requests.read_arm_file),
        {"arm": [*requests.ARM_FILES, *(yaml.safe_dump(it).encode() for it in requests.ARM_FILES)]},
    ),
    "notation": (simply(requests.read_notation), {"notation": [it.encode() for it in requests.NOTATIONS]}),
    "recording": (simply(read_recording), {"recording": [bytes([k]) for k in range(5)]}),
    "daemon": (
        daemon,
        {
            **{"goal": [told.GOAL, told.LINE, told.CONFIGURATIONS], "plan": [told.GOAL]},
            **{"jog": [told.JOG], "degrade": [told.DEGRADE], "obstacles": [told.OBSTACLES]},
            **{"cancel": [{"id": "a-1"}], "stop": [{}], "reset": [{}], "fault": [{"fault": "power_cut can0/5"}]},
            "poses": [{"save": "p", "goal": told.POSE["goal"]}, {"remove": "p"}],
            **{"arm": [{"with": ["drawing"]}], "result": [{"id": "a-1"}], "setpoint": [told.SETPOINT]},
        },
    ),
    "recorder": (recorder, {**PUBLISHED, "setpoint": [told.SETPOINT]}),
    "page": (page, PUBLISHED),
    "page_request": (page_request, {"live": [{"do": "jog", "n": 1, "actuator": "5.left", "state": "extended"}]}),
    "http": (
        http,
        {
            **{"session": [{"token": "abc"}], "path": [b"/arms/planar16/density"], "cookie": [b"hyperbit=abc"]},
            **{"authorization": [b"Bearer abc"], "origin": [b"http://127.0.0.1:7480"], "host": [b"127.0.0.1:7480"]},
        },
    ),
    "fleet": (fleet, {"arm": PUBLISHED["arm"], "state": PUBLISHED["state"], "stop": [told.ANSWER]}),
    "client": (
        client,
        {
            **{key: PUBLISHED[key] for key in ("state", "diagnostics", "feedback", "result", "arm")},
            **{"stop": [told.ANSWER], "plan": [told.ANSWER]},
        },
    ),
    "player": (player, {"timeline": [{"at": 2.0, "speed": 2, "paused": True}]}),
    "bridge": (bridge, {**PUBLISHED, **{name: [serialize({}, form, TYPES)] for name, (_, form) in KINDS.items()}}),
    "packed": (
        packed,
        {
            "up": [encode(Accepted(1, 2.0)), encode(Question(1, b"\1", b"\3"))],
            "down": [encode(message) for message in MESSAGES],
            "context": [encode(Context("a", position=[0.5, 2.9], bias=[0.0, 0.1]))],
        },
    ),
    "files": (
        small_files,
        {
            "poses": [{"a": told.POSE["goal"]}],
            "goals": [[{"uuid": "0" * 32, "kind": "tip", "joints": ["tip_x"], "stamp": 1, "result": None}]],
            "sessions": [{"a": {"name": "anna", "role": "operator"}}],
            "people": [{"people": [{"name": "anna", "role": "viewer"}]}],
            "claimant": [{"daemon": {"host": "a", "pid": 1, "serves": True}}],
        },
    ),
}


def built(name: str) -> Quiet:
    return Quiet(READERS[name][0](), starts=name == "files")


def samples(name: str) -> list[tuple[str, bytes]]:
    """Returns valid inputs of a reader, and those that once did harm."""
    valid = [
        (key, it if isinstance(it, bytes) else json.dumps(it).encode())
        for key, its in READERS[name][1].items()
        for it in its
    ]
    found = [path.read_bytes().partition(b"\n") for path in sorted(CORPUS.glob(f"{name}-*"))]
    return [*valid, *((key.decode(), data) for key, _, data in found)]


def mutation(name: str, number: int) -> tuple[str, bytes]:
    """Returns the mutation with a number of one of the samples; always the same."""
    chance = random.Random(f"{name} {number}")
    key, data = chance.choice(samples(name))
    return key, mutated(data, chance)
