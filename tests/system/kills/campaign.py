"""Kills at one moment, one after another, on one arm; and what must hold after each of them."""

import json
import random
import socket
import threading
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import can

from hyperbit.controller.planning.ledger_file import read
from tests.system.kills.moments import MOMENTS, Requests, Scene, ordered
from tests.system.kills.trigger import MARK, SOCKET, Order
from tests.system.operator import Operator
from tests.system.stack.lives import Lives
from tests.system.stack.places import LEFT, RIGHT
from tests.system.stack.processes import Nursery
from tests.system.stack.system import System
from tests.waiting import SLOWNESS, eventually

RESULT_TIMEOUT = 30.0 * SLOWNESS  # [s]
ATTEMPTS = 5  # to reach a moment


class KillNursery(Nursery):
    module = "tests.system.kills.nursery"


@dataclass
class Tally:
    """The counts of one moment and process.

    Attributes:
        goals: number of goals and jogs whose acceptance a client received.
        results: number of results, of all goals and jogs.
        unanswered: goals and jogs with a result whose acceptance no client received.
        doubled: goals with more than one result; goals without an answer count, too.
        repeated: goals that two planners accepted, because a client without an answer asked again.
        again: goals with a result that came again, and was marked as repeated.
        wrong: doubled and missing results, and what else was wrong, in words.
    """

    kills: int = 0
    goals: int = 0
    results: int = 0
    unanswered: int = 0
    doubled: int = 0
    missing: int = 0
    lost: int = 0
    repeated: int = 0
    again: int = 0
    wrong: list[str] = field(default_factory=list)


class Campaign:
    """Kills of one arm's processes."""

    def __init__(self, make: Callable[[], System]) -> None:
        self._make = make
        self.tallies: dict[tuple[str, str], Tally] = {}
        self._stack = ExitStack()
        self._lives: Lives | None = None
        self._goals: dict[str, tuple[Tally, str, int]] = {}  # with the number of its results

    def close(self) -> None:
        self.finish()
        self._stack.close()
        self._lives = None

    def kill(self, moment: str, victim: str, number: int) -> None:
        """Kills a process once at a moment, and counts what follows. `number` seeds the choice of the step."""
        tally = self.tallies.setdefault((moment, victim), Tally())
        seed = f"{moment}/{victim}/{number}"
        try:
            self._kill(moment, victim, seed, tally)
        except AssertionError as error:
            tally.wrong.append(f"{seed}: {error!r:.3000}")
            self.close()

    def _kill(self, moment: str, victim: str, seed: str, tally: Tally) -> None:
        refusals: list[str] = []
        for attempt in range(ATTEMPTS):
            lives = self._lives or self._begin()
            lives.ready()
            name = f"{seed}/{attempt}"
            chance = random.Random(name)
            order = ordered(moment, victim, chance, lives.system.planner.pid, lives.system.executor.pid)
            scene = Scene(lives, Requests(lives), chance, name)
            hit = self._reach(lives, moment, order, scene)
            self._recover(lives)
            self._judge(scene, f"{name} {tuple(order[:4])} {hit}", tally)
            if hit:
                tally.kills += 1
                return
            refusals += scene.requests.refusals
        raise AssertionError(f"the moment was not reached; refused was: {refusals}")

    def _begin(self) -> Lives:
        system = self._stack.enter_context(closing(self._make()))
        self._lives = lives = Lives(system, self._stack)
        buffered = self._stack.enter_context(closing(Buffered(lives.motions.listener)))
        lives.motions.listener = buffered  # type: ignore[assignment]  # all that motions need
        return lives

    def _reach(self, lives: Lives, moment: str, order: Order, scene: Scene) -> str:
        """Orders a kill, brings its moment about, and starts again what was killed.

        Returns:
            the time of the kill [s]; "" if the moment was not reached.
        """
        system, log = lives.system, Log(lives.system.planner.log)
        planner, executor = system.planner, system.executor
        command(system, order)
        with MOMENTS[moment].scene(scene):
            eventually(lambda: log.killed() or scene.requests.over() or not planner.alive, told=system.logs)
            if moment == "shutdown" and not log.killed():
                planner.gone()
            if hit := log.killed():
                for process in (planner, executor):
                    if process.pid in order.pids:
                        process.gone()
            elif planner.alive:
                command(system, order._replace(moment="never"))
                lives.client.ask("cancel")
            if moment == "shutdown":
                planner.gone()
            if not executor.alive:
                system.start_executor()
            if not planner.alive:
                system.start_planner_process()
        scene.requests.join()
        return hit

    def _recover(self, lives: Lives) -> None:
        for lock in lives.ready()["degraded"]:
            eventually(lambda label=lock["actuator"]: self._unlock(lives, label))
        eventually(lambda: lives.client.ask("obstacles", regions=[])["accepted"])
        eventually(lambda: lives.ready()["degraded"] == [])

    def _unlock(self, lives: Lives, label: str) -> bool:
        return bool(lives.client.ask("degrade", actuator=label, state=None)["accepted"])

    def _judge(self, scene: Scene, told: str, tally: Tally) -> None:
        lives, goals = scene.lives, scene.requests.goals()
        for goal in (goal for goal, accepted in goals.items() if accepted):
            try:
                eventually(lambda goal=goal: lives.client.results(goal), patience=RESULT_TIMEOUT)
            except AssertionError:
                tally.missing += 1
                tally.wrong.append(f"{told}: {goal} has no result; in the ledger: {rows(lives.system, goal)}")
        lives.move(f"{scene.name} check", LEFT, RIGHT)
        lives.motions.agree(lives.system.boards)
        with Operator(lives.system.socket) as operator:
            counts, switched = operator.counts(), lives.motions.switched.tolist()
            assert counts == switched, f"{told}: the executor counts {counts}, on the bus there were {switched}"
        for goal, accepted in goals.items():
            entries = eventually(lambda goal=goal: all_ended(lives.system, goal) is not None) and rows(
                lives.system, goal
            )
            results = lives.client.results(goal)
            self._goals[goal] = tally, told, len(results)
            tally.goals += accepted
            tally.results += len(results)
            tally.again += lives.client.repeats(goal)
            tally.lost += any(result["status"] == "lost" for result in results)
            tally.unanswered += not accepted and bool(results)
            if len(results) > 1 and len(entries) == len(results):
                tally.repeated += 1
            elif len(results) > 1:
                tally.doubled += 1
                tally.wrong.append(f"{told}: {goal} has the results {results}, in the ledger: {entries}")
            elif accepted and len(entries) != 1:
                tally.wrong.append(f"{told}: {goal} has the entries {entries} in the ledger")

    def finish(self) -> None:
        """Counts results that came later."""
        if self._lives is None:
            return
        for goal, (tally, told, count) in self._goals.items():
            results = self._lives.client.results(goal)
            if len(results) > max(count, 1):
                tally.doubled += 1
                tally.wrong.append(f"{told}: {goal} has a late result: {results}")
        self._goals.clear()


class Buffered:
    """A listener whose frames a thread reads, because a socket that nobody reads loses frames.

    Args:
        bus: of the listener; ends with it.
    """

    def __init__(self, bus: can.BusABC) -> None:
        self._bus, self._frames = bus, deque[can.Message]()
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._read, name="listener", daemon=True)
        self._thread.start()

    def recv(self, timeout: float) -> can.Message | None:
        """Returns the next frame, None if there is none; never waits."""
        return self._frames.popleft() if self._frames else None

    def close(self) -> None:
        self._over.set()
        self._thread.join()

    def _read(self) -> None:
        while not self._over.is_set():
            if (frame := self._bus.recv(0.1)) is not None:
                self._frames.append(frame)


class Log:
    def __init__(self, path: Path) -> None:
        self._path = path
        self._begin = path.stat().st_size if path.exists() else 0

    def killed(self) -> str:
        """Returns when an order was carried out [s], "" if none was."""
        with self._path.open("rb") as file:
            file.seek(self._begin)
            lines = [line for line in file.read().decode(errors="replace").splitlines(keepends=True) if MARK in line]
        return lines[-1].split()[-1] if lines and lines[-1].endswith("\n") else ""


def command(system: System, order: Order) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as client:
        eventually(lambda: client.connect_ex(str(system.folder / SOCKET)) == 0)
        client.send(json.dumps(order).encode())
        assert client.recv(100)


def rows(system: System, goal: str) -> list[dict[str, Any]]:
    return [row for row in read(system.ledger)[1] if row["id"] == goal]


def all_ended(system: System, goal: str) -> list[dict[str, Any]] | None:
    """Returns the ledger's entries of a goal, None while one of them has no result."""
    found = rows(system, goal)
    return None if any(row["ended"] is None for row in found) else found
