"""Kills at chosen moments, one after another, on one arm; and what must hold after each of them."""

import json
import random
import socket
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hyperbit.controller.planning.ledger_file import read
from tests.system.kills.moments import Scene, ordered, played
from tests.system.kills.trigger import MARK, SOCKET, Order
from tests.system.operator import Operator
from tests.system.stack import arms
from tests.system.stack.lives import Lives
from tests.system.stack.places import LEFT, RIGHT
from tests.system.stack.processes import Nursery
from tests.system.stack.system import System
from tests.waiting import SLOWNESS, eventually

RESULT_TIMEOUT = 30.0 * SLOWNESS  # [s]
ATTEMPTS = 5  # to reach a moment


def kill_nursery(folder: Path) -> Nursery:
    """Returns a process that forks planners with a trigger."""
    file = arms.write(folder, "planar", "none", arms.NO_BUS, {})
    return Nursery("planner", folder, file, module="tests.system.kills.trigger")


@dataclass
class Tally:
    """The counts of one moment and process.

    Attributes:
        goals: number of goals and jogs whose acceptance a client received.
        results: number of results, of all goals and jogs.
        repeated: goals that two planners accepted, because a client without an answer asked again.
        again: goals with a result that came again, and was marked as repeated.
        wrong: doubled and missing results, and what else was wrong, in words.
    """

    kills: int = 0
    goals: int = 0
    results: int = 0
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
        """Counts results that came later, and ends all processes."""
        for goal, (tally, told, count) in self._goals.items():
            if self._lives and len(results := self._lives.client.results(goal)) > max(count, 1):
                tally.wrong.append(f"{told}: {goal} has a late result: {results}")
        self._goals.clear()
        self._stack.close()
        self._lives = None

    def kill(self, moment: str, victim: str, number: int) -> None:
        """Kills a process once at a moment, and counts what follows. `number` seeds the choice of the step."""
        tally = self.tallies.setdefault((moment, victim), Tally())
        seed, refusals = f"{moment}/{victim}/{number}", list[str]()
        try:
            for attempt in range(ATTEMPTS):
                lives = self._lives or self._begin()
                lives.ready()
                scene = Scene(lives, random.Random(f"{seed}/{attempt}"), f"{seed}/{attempt}")
                pids = lives.system.planner.pid, lives.system.executor.pid
                order = ordered(moment, victim, scene.chance, *pids)
                hit = self._reach(lives, moment, order, scene)
                self._recover(lives)
                self._judge(scene, f"{scene.name} {tuple(order[:4])} {hit}", tally)
                if hit:
                    tally.kills += 1
                    return
                refusals += scene.refusals
            raise AssertionError(f"the moment was not reached; refused was: {refusals}")
        except AssertionError as error:
            tally.wrong.append(f"{seed}: {error!r:.3000}")
            self.close()

    def _begin(self) -> Lives:
        system = self._stack.enter_context(closing(self._make()))
        self._lives = Lives(system, self._stack)
        return self._lives

    def _reach(self, lives: Lives, moment: str, order: Order, scene: Scene) -> str:
        """Orders a kill, brings its moment about, and starts again what was killed.

        Returns:
            the time of the kill [s]; "" if the moment was not reached.
        """
        system = lives.system
        planner, executor = system.planner, system.executor
        killed = killed_in(planner.log)
        command(system, order)
        with played(moment, scene):
            eventually(lambda: killed() or scene.over() or not planner.alive, told=system.logs)
            if moment == "shutdown" and not killed():
                planner.gone()
            if hit := killed():
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
        return hit

    def _recover(self, lives: Lives) -> None:
        for lock in lives.ready()["degraded"]:
            unlock = {"actuator": lock["actuator"], "state": None}
            eventually(lambda unlock=unlock: lives.client.ask("degrade", **unlock)["accepted"])
        eventually(lambda: lives.client.ask("obstacles", regions=[])["accepted"])
        eventually(lambda: lives.ready()["degraded"] == [])

    def _judge(self, scene: Scene, told: str, tally: Tally) -> None:
        lives, system = scene.lives, scene.lives.system
        for goal in (goal for goal, accepted in scene.goals.items() if accepted):
            try:
                eventually(lambda goal=goal: lives.client.results(goal), patience=RESULT_TIMEOUT)
            except AssertionError:
                tally.wrong.append(f"{told}: {goal} has no result; in the ledger: {rows(system, goal)}")
        lives.move(f"{scene.name} check", LEFT, RIGHT)
        lives.motions.agree(system.boards)
        with Operator(system.socket) as operator:
            counts, switched = operator.counts(), lives.motions.switched.tolist()
            assert counts == switched, f"{told}: the executor counts {counts}, on the bus there were {switched}"
        for goal, accepted in scene.goals.items():
            eventually(lambda goal=goal: all(row["ended"] is not None for row in rows(system, goal)))
            entries, results = rows(system, goal), lives.client.results(goal)
            self._goals[goal] = tally, told, len(results)
            tally.goals += accepted
            tally.results += len(results)
            tally.again += lives.client.repeats(goal)
            tally.lost += any(result["status"] == "lost" for result in results)
            if len(results) > 1 and len(entries) == len(results):
                tally.repeated += 1
            elif len(results) > 1 or (accepted and len(entries) != 1):
                tally.wrong.append(f"{told}: {goal} has the results {results}, in the ledger: {entries}")


def killed_in(log: Path) -> Callable[[], str]:
    """Returns a function that tells when an order was carried out from now on [s], "" if none was."""
    begin = log.stat().st_size if log.exists() else 0

    def killed() -> str:
        with log.open("rb") as file:
            file.seek(begin)
            lines = [line for line in file.read().decode(errors="replace").splitlines(keepends=True) if MARK in line]
        return lines[-1].split()[-1] if lines and lines[-1].endswith("\n") else ""

    return killed


def command(system: System, order: Order) -> None:
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as client:
        eventually(lambda: client.connect_ex(str(system.folder / SOCKET)) == 0)
        client.send(json.dumps(order).encode())
        assert client.recv(100)


def rows(system: System, goal: str) -> list[dict[str, Any]]:
    return [row for row in read(system.ledger)[1] if row["id"] == goal]
