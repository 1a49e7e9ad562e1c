"""Regression check: sends recorded goals to a simulated arm and compares the configurations."""

import contextlib
import hashlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path, PurePath
from typing import Any, NamedTuple

import msgspec
import zenoh

from hyperbit.controller.armfile.patience import patient_copy
from hyperbit.controller.network import session
from hyperbit.controller.network.client import Client, Unanswered
from hyperbit.controller.planning.ledger import Ledger
from hyperbit.controller.recorder.history import RecordedChange, RecordedGoal, history
from hyperbit.controller.recorder.reader import RecordingReader
from hyperbit.controller.recorder.repair import BadRecording, guarded
from hyperbit.controller.search.method import MINIMUM_SWITCH

Message = Mapping[str, Any]

STARTING = 900.0  # [s] until the simulated arm is ready: it may compile kernels and map the workspace
ANSWER, SETTLING, POLL = 20.0, 20.0, 0.02  # [s]
LAST_LINES = 5  # of the log of a daemon that does not start


class ArmFailed(Exception):
    """The simulated arm does not start or does not answer; the text says why."""


class Compared(NamedTuple):
    """Comparison of a recorded goal.

    Attributes:
        id: id of the goal.
        outcome: "equal"; "differs"; "unproven" if it differs without a proof of fewest switches, so that the speed of
            the computer decides; "skipped" if it cannot be compared.
        reason: the difference, or why the goal was skipped.
    """

    id: str
    outcome: str
    reason: str = ""


class SimulatedArm:
    """A daemon with simulated boards at a private endpoint.

    Args:
        client: client of the daemon.
        ended: returns the exit code of the daemon; None while it runs.
    """

    def __init__(self, client: Client, ended: Callable[[], int | None]) -> None:
        self._client, self._ended = client, ended
        self._state: Message = {}
        self._since = 0.0  # UNIX time of the last answer or result [s]; states before it are old
        self._subscriber = client.subscribe("state", self._hear)

    def close(self) -> None:
        """Ends the subscription; before the session, which otherwise logs samples that arrive meanwhile as errors."""
        self._subscriber.undeclare()  # type: ignore[no-untyped-call]

    def _hear(self, message: Message) -> None:
        self._state = message

    def wait_ready(self, timeout: float = SETTLING) -> Message:
        """Waits until the arm is in mode ready; returns its state.

        Raises:
            ArmFailed: the arm is not ready in time.
        """
        until = time.monotonic() + timeout
        while time.monotonic() < until:
            if (code := self._ended()) is not None:
                raise ArmFailed(f"the simulated arm ended with code {code}")
            if self._state.get("mode") == "ready" and self._state.get("stamp", 0.0) > self._since:
                return self._state
            time.sleep(POLL)
        raise ArmFailed(f"the simulated arm is not ready: {self._state.get('reason', 'it does not answer')}")

    def ask(self, key: str, payload: Mapping[str, Any]) -> Message:
        """Sends a request and returns the answer.

        Raises:
            ArmFailed: the arm does not answer.
        """
        try:
            return self._client.request(key, payload, ANSWER)
        except Unanswered as error:
            raise ArmFailed(str(error)) from None
        finally:
            self._since = time.time()

    def bring(self, configuration: str) -> bool:
        """Moves the arm to a configuration; returns whether it arrived."""
        if self.wait_ready().get("configuration") == configuration:
            return True
        self.run({"waypoints": [{"configuration": configuration}]})
        return self.wait_ready().get("configuration") == configuration

    def run(self, goal: Mapping[str, Any]) -> tuple[Message, dict[int, str | None]]:
        """Runs a goal; returns its result, and the configuration at each waypoint by its number.

        Raises:
            ArmFailed: there is no result.
        """
        reached: dict[int, str | None] = {}

        def follow(message: Message) -> None:
            if "waypoint" in message:
                reached[message["waypoint"]] = message.get("configuration")

        self.wait_ready()
        try:
            return self._client.run(goal, follow, silence=SETTLING), reached
        except Unanswered as error:
            raise ArmFailed(str(error)) from None
        finally:
            self._since = time.time()


def compare(past: RecordingReader, file: Path | None, report: Callable[[Compared], None]) -> None:
    """Sends the goals of a recording to a simulated arm, one after the other, and compares the configurations.

    Args:
        past: the recording.
        file: the arm's file, instead of the recorded one.
        report: called with the comparison of each recorded goal.

    Raises:
        ArmFailed: the arm does not start, or does not answer.
        BadRecording: the recording is damaged.
    """
    steps, anytime = history(past), (past.description or {}).get("method") == MINIMUM_SWITCH
    with simulated(past, file) as arm:
        for step in steps:
            if isinstance(step, RecordedChange):
                if not (answer := arm.ask(step.key, step.payload)).get("accepted"):
                    raise ArmFailed(f"the simulated arm refuses a recorded {step.key}: {answer.get('message')}")
                arm.wait_ready(STARTING)  # the planner rebuilds its tables for locked actuators
                continue
            with guarded(past.path, ArmFailed, zenoh.ZError):
                found = compared(arm, step, anytime=anytime)
            report(found)


def compared(arm: SimulatedArm, goal: RecordedGoal, *, anytime: bool) -> Compared:
    """Sends one goal from its recorded start, and returns the comparison.

    Args:
        arm: the simulated arm.
        goal: the recorded goal.
        anytime: whether the search uses all its time, so that only proven plans are reproducible.
    """
    if goal.incomparable is not None:
        return Compared(goal.id, "skipped", goal.incomparable)
    if goal.start is not None and not arm.bring(goal.start):
        return Compared(goal.id, "skipped", f"the simulated arm does not reach its start {goal.start}")
    stamp = goal.payload.get("stamp") or 0.0
    later = {"stamp": time.time() + stamp - goal.stamp} if stamp else {}
    result, reached = arm.run({**goal.payload, "id": goal.id, **later})
    if not goal.accepted:
        if result.get("accepted") is False:
            return Compared(goal.id, "equal")
        # The search found no configuration within its time; that does not prove that there is none.
        return Compared(goal.id, "unproven" if anytime else "differs", "it was refused then, and is accepted now")
    if result.get("status") != "succeeded":
        return Compared(goal.id, "differs", f"it succeeded then, now: {result.get('message')}")
    then = goal.result or {}
    if (difference := differs(goal, then, result, reached)) is None:
        return Compared(goal.id, "equal")
    proven = then.get("certificate") == result.get("certificate") == "optimal"
    return Compared(goal.id, "differs" if proven or not anytime else "unproven", difference)


def differs(goal: RecordedGoal, then: Message, now: Message, reached: Mapping[int, str | None]) -> str | None:
    """Returns the first difference of configurations in words; None if there is none."""
    for waypoint, configuration in sorted(goal.configurations.items()):
        if reached.get(waypoint) != configuration:
            return f"waypoint {waypoint + 1}: {configuration} then, {reached.get(waypoint)} now"
    if now.get("configuration") != then.get("configuration"):
        return f"at the end: {then.get('configuration')} then, {now.get('configuration')} now"
    return None


@contextlib.contextmanager
def simulated(past: RecordingReader, file: Path | None) -> Iterator[SimulatedArm]:
    """Runs a daemon with simulated boards for a recording, with its own folder and sockets.

    Raises:
        ArmFailed: the daemon does not start.
    """
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="hyperbit-")))
        (recorded := folder / "recorded").mkdir()
        ledger = folder / "ledger.db"
        path = patient_copy(prepared(past, file, recorded, ledger), folder)
        endpoint, log = f"unixsock-stream/{folder / 'zenoh.sock'}", folder / "log"
        command = [sys.executable, "-m", "hyperbit", "run", str(path), "--simulate", "--listen", endpoint]
        process = subprocess.Popen(
            [*command, "--ledger", str(ledger)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=stack.enter_context(log.open("wb")),
            env={**os.environ, "RUNTIME_DIRECTORY": str(folder)},
            process_group=0,  # Ctrl-C ends this process, which then ends the daemon
        )
        stack.callback(process.wait)
        stack.callback(process.send_signal, signal.SIGTERM)
        config = session.configuration("client", connect=endpoint)
        live, until = None, time.monotonic() + STARTING
        while live is None:
            if process.poll() is not None or time.monotonic() > until:
                words = log.read_text(errors="replace").strip().splitlines()[-LAST_LINES:]
                raise ArmFailed("the simulated arm does not start: " + "\n".join(words))
            with contextlib.suppress(zenoh.ZError):
                live = stack.enter_context(zenoh.open(config))
            time.sleep(POLL)
        client = stack.enter_context(contextlib.closing(Client(live, past.arm, lambda: zenoh.open(config))))
        arm = stack.enter_context(contextlib.closing(SimulatedArm(client, process.poll)))
        arm.wait_ready(STARTING)
        yield arm


def prepared(past: RecordingReader, file: Path | None, folder: Path, ledger: Path) -> Path:
    """Writes what the simulated arm needs of a recording: a ledger, and its file, unless `file` is given.

    Returns the path of the arm's file.

    Raises:
        BadRecording: the recording is damaged, or has no valid arm's file.
    """
    with guarded(past.path):
        counted(past, ledger)
        return arm_file(past, folder) if file is None else file


def arm_file(past: RecordingReader, folder: Path) -> Path:
    """Writes the recorded arm's file and its tables into a folder; returns the file's path.

    Raises:
        BadRecording: the recording has no valid arm's file.
    """
    file = (past.description or {}).get("file")
    if not isinstance(file, dict) or not isinstance(file.get("text"), str):
        raise BadRecording(f"{past.path} does not contain the arm's file: name it by --arm")
    if hashlib.sha256(file["text"].encode()).hexdigest() != file.get("sha256"):
        raise BadRecording(f"{past.path}: the arm's file in it was changed: name the file by --arm")
    for name, text in (file.get("tables") or {}).items():
        if PurePath(name).is_absolute() or ".." in PurePath(name).parts:
            raise BadRecording(f"{past.path}: a table of the arm's file would be written to {name}")
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    path = folder / "arm.yaml"
    path.write_text(file["text"], encoding="utf-8")
    return path


def counted(past: RecordingReader, path: Path) -> None:
    """Writes a ledger with each actuator's switches at the begin of the recording, on which weights may depend."""
    labels = (past.description or {}).get("actuators") or ()
    for message in past.messages():
        counts = msgspec.json.decode(message.data).get("counts") if message.key == "diagnostics" else None
        if counts and len(counts) == len(labels):
            with contextlib.closing(Ledger(path, labels)) as ledger:
                ledger.counts(counts)
            return
