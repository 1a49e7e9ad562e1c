"""The planner's process: the real loop around the core on the simulated clock, its end and its next start."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from random import Random
from typing import TYPE_CHECKING

from hyperbit.controller.gateway import daemon as daemon_module
from hyperbit.controller.gateway import outbox as outbox_module
from hyperbit.controller.gateway import server as server_module
from hyperbit.controller.gateway.arrivals import Clocks, RepeatedGoals
from hyperbit.controller.gateway.daemon import Warnings
from hyperbit.controller.gateway.outbox import Outbox
from hyperbit.controller.gateway.server import GatewayParts, Server
from hyperbit.controller.host.process import Quit
from hyperbit.controller.messages.goals import Result
from hyperbit.controller.motion.stages.pacing import pace_of
from hyperbit.controller.obstacles.obstacles import NONE
from hyperbit.controller.planning import ledger as ledger_module
from hyperbit.controller.planning import ledger_file
from hyperbit.controller.planning import loop as loop_module
from hyperbit.controller.planning.core.core import Beginning, Core
from hyperbit.controller.planning.core.events import Action, Event, Identity, Recorded, Reply
from hyperbit.controller.planning.core.tasks import BuildScene, BuildTables
from hyperbit.controller.planning.ledger import PublishedResults
from hyperbit.controller.planning.link import ExecutorLink
from hyperbit.controller.planning.loop import Loop, PlannerFailed, Services
from hyperbit.controller.planning.planner import Planner
from hyperbit.controller.planning.workers import pool as pool_module
from hyperbit.controller.planning.workers.computations import build_scene, build_tables
from tests.simulation.network import SimulatedLink
from tests.simulation.verdict import Violation, require
from tests.simulation.whole.workers import LateWorkers

if TYPE_CHECKING:
    from tests.simulation.whole.daemon import Daemon

WAKE_UP = 0.0005  # [s], longest
QUIT_WITHIN = 1.5  # [s], after which the process ends without its last results
SPIN, MOST_IDLE = 1e-4, 20  # [s] between rounds without events, and number of those in a row
UNIX = 1.7e9  # [s] between the two clocks

LEASE = 4.0  # [s] of the simulated session
INTERLEAVED = 0.3  # share of the places between two steps of a thread at which the loop's thread runs
SENDS_WITHIN = 0.0003  # [s], time of the outbox for a message

MODULES = (daemon_module, loop_module, outbox_module, server_module, ledger_module, ledger_file, pool_module)
LOGS = tuple(module.log for module in MODULES)


class Killed(BaseException):
    """The process was killed at an action."""


class SimulatedInbox:
    """The events that were posted to one process."""

    def __init__(self, process: PlannerProcess) -> None:
        self.events: deque[Event] = deque()
        self._process = process

    def post(self, event: Event) -> None:
        self.events.append(event)
        self.wake()

    def wake(self) -> None:
        self._process.wake_soon()

    def end_wait(self) -> None:
        """Does nothing."""

    def wait(self, timeout: float, link: ExecutorLink) -> bool:
        """Returns whether the link is ready; does not wait."""
        return self._process.link.ready


class KillableLoop(Loop):
    """The loop, with a function that is called before each action."""

    before: Callable[[Action], None]
    check: Callable[[], None]  # is called after each step

    def _carry_out(self, action: Action) -> None:
        self.before(action)
        self._act(action)

    def _record(self, event: Event, now: float, wall: float, actions: Sequence[Action] | None) -> None:
        assert self.recorder is not None
        self.recorder(event, now, wall, actions)  # what the judge raises ends the run
        if actions is not None:
            self.check()

    def due(self, retry_at: float) -> float:
        """Returns when the loop must run again without an event [s]."""
        return min(self._wake, self.warnings_at, self.look_at, retry_at)


class SteppedOutbox(Outbox):
    """The outbox, whose steps are called at simulated times."""

    wake_at: Callable[[float], None]  # wants a step after a time [s]

    def _wake_up(self) -> None:
        self.wake_at(SENDS_WITHIN)


class PlannerProcess:
    """One process of a planner. Its threads share the life of the process.

    Attributes:
        name: number of the process, in the ids of jogs.
        marked: is called after each mark of a published result, and after each record.
    """

    def __init__(self, daemon: Daemon, number: int, random: Random) -> None:
        self.alive, self.number, self.quits_at = True, number, math.inf
        self._daemon, self._agenda, self._random = daemon, daemon.agenda, random
        self._next = math.inf  # time of the next round [s]
        self._idle_rounds, self._rang_at = 0, -math.inf
        self.actions_left: int | None = None
        self.marked: Callable[[], None] = lambda: None
        self._rounding = False
        arm, storage, post = daemon.arm, daemon.storage, self.post
        self.inbox = SimulatedInbox(self)
        self.link = SimulatedLink(
            daemon.network, arm.settings.name, daemon.executed.digest, self._now, daemon.simulated, self.interleave
        )
        self.ledger, published = storage.begin(self._agenda, self._recorded), storage.published()
        parts = arm, daemon.densities, daemon.weights, daemon.solver
        self.workers = LateWorkers(self._agenda, random, daemon.mood, daemon.search_clock, parts, post)
        self.session, self.goals = daemon.zenoh.open(), RepeatedGoals(self._now)
        hooks = self.goals.ended, partial(self._marks, published), post
        name = arm.settings.name
        self.outbox = SteppedOutbox(self.session, f"hyperbit/{name}", *hooks, self._never, LEASE, self._now)  # type: ignore[arg-type]
        self._outbox_at = math.inf
        self.outbox.wake_at = self._send_within
        network = daemon.zenoh
        warnings = Warnings(lambda: not network.lost, self.ledger.faults, daemon.wall, self._now)
        services = Services(self.inbox, self.ledger, published, self.outbox, self, warnings.active, self._never)  # type: ignore[arg-type]
        locked = bytes(
            (daemon.executed.locked_states >> k & 1) if daemon.executed.locked >> k & 1 else 255
            for k in range(len(daemon.executed.actuators))
        )
        scene = build_scene(arm, BuildScene(0, NONE))
        beginning = Beginning(
            f"p{number}-",
            build_tables(arm, daemon.densities, daemon.weights, BuildTables(0, locked), daemon.solver),
            scene.scene,
            scene.total,
            self.ledger.known,
            published.known(),
            self.ledger.owed,
            simulated=daemon.simulated,
        )
        self.core = Core(arm, pace_of(arm.settings), beginning)
        clocks = self._now, daemon.wall
        self.loop = KillableLoop(self.core, self.link, self.workers, services, daemon.witness, clocks)  # type: ignore[arg-type]
        self.loop.before = self._before
        self.loop.check = self._check
        self.loop.ended.clear()
        gateway_clocks, finds = Clocks(self._now, daemon.wall, self._pause), partial(ledger_file.find, storage.path)
        planner = Planner(arm, None, self.loop)  # type: ignore[arg-type]
        gateway = GatewayParts(planner, self.outbox, self.goals, storage.poses(), finds, gateway_clocks)
        self.server = Server(self.session, name, gateway)  # type: ignore[arg-type]
        self.wake_soon()
        self._send_within(0.0)

    def _recorded(self, entry: int) -> None:
        self.marked()
        self.interleave()
        self.post(Recorded(entry))

    def _marks(self, published: PublishedResults, identity: Identity, result: Result) -> None:
        published.add(identity, result)
        self.marked()
        self.interleave()

    def interleave(self) -> None:
        """Lets the loop's thread run between two steps of another thread, perhaps."""
        awake = self._agenda.now >= self._daemon.awake_since
        if self.alive and awake and not self._rounding and self._random.random() < INTERLEAVED:
            self._round()

    def _pause(self, seconds: float) -> None:
        """Holds up no other thread of the gateway."""

    def _send_within(self, seconds: float) -> None:
        at = self._agenda.now + self._random.uniform(0.0, seconds)
        if at < self._outbox_at:
            self._outbox_at = at
            self._agenda.at(at, lambda: self._send(at))

    def _send(self, at: float) -> None:
        if not self.alive or at != self._outbox_at:
            return
        self._outbox_at = math.inf
        if self._agenda.now < self._daemon.awake_since:
            self._outbox_at = self._daemon.awake_since
            self._agenda.at(self._outbox_at, lambda: self._send(self._outbox_at))
            return
        wait = self.outbox.step()
        busy = self._daemon.congestion * self._random.random()
        at = self._agenda.now + (wait or self._random.uniform(0.0, SENDS_WITHIN)) + busy
        if at < self._outbox_at or busy:
            self._outbox_at = at
            self._agenda.at(at, lambda: self._send(at))

    def post(self, event: Event) -> None:
        if self.alive:
            self.inbox.post(event)

    def quit(self) -> None:
        """Asks the process to end, as SIGTERM does."""
        if self.quits_at == math.inf:
            self.quits_at = self._agenda.now + QUIT_WITHIN
            self.server.close()
            self._daemon.exchange.quits = True
            self.post(Quit())
            self._agenda.at(self.quits_at, lambda: self._end(in_order=True))

    def notify(self, assignment: str) -> None:
        """Does nothing: there is no service manager."""

    def wake_soon(self) -> None:
        self._wake_at(self._agenda.now + self._random.uniform(0.0, WAKE_UP))

    def _wake_at(self, at: float) -> None:
        if self.alive and at < self._next:
            self._next = at
            self._agenda.at(at, lambda: self._ring(at))

    def _ring(self, at: float) -> None:
        if not self.alive or at != self._next:
            return
        self._next = math.inf
        if self._agenda.now < self._daemon.awake_since:
            self._wake_at(self._daemon.awake_since)
            return
        if self.inbox.events or self.link.ready or self._agenda.now > self._rang_at + SPIN:
            self._idle_rounds = 0
        self._idle_rounds, self._rang_at = self._idle_rounds + 1, self._agenda.now
        require(self._idle_rounds < MOST_IDLE, "the loop spins: the core wants to be woken again and again")
        self._round()
        if not self.alive:
            return
        if self.core.ended and self.loop.ended.is_set() and self.quits_at < math.inf:
            self._end(in_order=True)
            return
        retry_at = self.link.retry_at if self.link.fileno() < 0 else math.inf
        due = self.loop.due(retry_at)
        self._daemon.slow_down()
        self._wake_at(self._agenda.now if self.link.ready else max(due, self._agenda.now) + 1e-5)

    def _round(self) -> None:
        self._rounding = True
        try:
            self.loop.round()
        except Killed:
            self.kill()
        except PlannerFailed as failure:
            self._daemon.fails(str(failure))
            self.kill()
        finally:
            self._rounding = False

    def _before(self, action: Action) -> None:
        if self.actions_left is not None:
            self.actions_left -= 1
            if self.actions_left < 0:
                raise Killed
        if isinstance(action, Reply):
            require(action.number in self.loop.replies, f"{action} answers no request, or one that was answered")
        self._daemon.witness.acts(action)

    def _check(self) -> None:
        try:
            self.core.check()
        except AssertionError as error:
            raise Violation(f"the planner's core: {error}") from error

    def kill_after(self, actions: int) -> None:
        """Kills the process after some further actions, perhaps in the middle of a step."""
        self.actions_left = actions

    def kill(self) -> None:
        if self.alive:
            self.alive = False
            self.workers.end()
            self.ledger.kill()
            self._daemon.zenoh.close()
            self.link.close()
            self._daemon.planner_ended()

    def _end(self, in_order: bool) -> None:
        """Ends the process after its goals."""
        if self.alive:
            self.actions_left = None
            self.loop.close()
            self.ledger.finish()
            self.outbox.close()
            while self.outbox.step() is not None:
                pass
            self._daemon.zenoh.finish()
            self.kill()

    def _now(self) -> float:
        return self._agenda.now

    def _never(self, reason: str) -> None:
        raise AssertionError(reason)
