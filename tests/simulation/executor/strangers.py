"""Clients beside the planner: operators, and programs that do not keep to the contract."""

from __future__ import annotations

from collections.abc import Callable
from random import Random

from hyperbit.controller.executor.core.events import ClientGone, ClientId, FromClient
from hyperbit.controller.program import (
    VERSION,
    Acknowledge,
    Alive,
    Cancel,
    Clearance,
    Counts,
    Down,
    Hello,
    Lock,
    PlayFault,
    Program,
    Reset,
    Setpoint,
    Stop,
    Trial,
)
from tests.simulation.agenda import Agenda
from tests.simulation.executor.process import ExecutorProcess

FIRST = 1_000_000  # number of the first connection; the planner's are lower
MOST = 4  # at a time
GREAT = 10**6  # counts of switches that no journal has


class Strangers:
    """Connects clients from time to time, and lets each say something.

    Attributes:
        may_stop: whether operators among them stop the arm.
    """

    def __init__(
        self,
        arm: str,
        count: int,
        agenda: Agenda,
        random: Random,
        executor: ExecutorProcess,
        planner_connected: Callable[[], bool],
    ) -> None:
        self.may_stop = False
        self._planner_connected = planner_connected
        self._arm, self._count, self._agenda, self._random, self._executor = arm, count, agenda, random, executor
        self._number = FIRST
        self._connected: list[ClientId] = []
        self._mean = random.choice([0.3, 1.0, 5.0])
        agenda.after(self._mean, self._act)

    def _act(self) -> None:
        random = self._random
        if self._executor.core is None:
            self._connected.clear()
        elif len(self._connected) < MOST and random.random() < 0.5:
            self._connect()
        elif self._connected:
            client = random.choice(self._connected)
            if random.random() < 0.4:
                self._connected.remove(client)
                self._executor.hear(client, ClientGone(client))
            else:
                self._say(client, self._message())
        self._agenda.after(random.expovariate(1 / self._mean), self._act)

    def _connect(self) -> None:
        self._number += 1
        client = ClientId(self._number, self._number)
        self._connected.append(client)
        drawn = self._random.random()
        if drawn < 0.1:
            self._say(client, self._message())  # without a Hello
        elif drawn < 0.5:
            self._say(client, Hello(VERSION, "operator", self._random.choice([self._arm, ""])))
        else:
            role = self._random.choice(["planner", "operator", "commissioner"])
            arm = self._random.choice([self._arm, "", "another"])
            version = self._random.choice([VERSION, VERSION - 1, VERSION + 1])
            if role != "operator" and arm == self._arm and version == VERSION and not self._planner_connected():
                arm = "another"
            self._say(client, Hello(version, role, arm))  # type: ignore[arg-type]

    def _message(self) -> Down:
        random, empty = self._random, bytes((self._count + 7) // 8)
        messages: list[Down] = [
            Alive(),
            Acknowledge(random.randint(0, 5)),
            Cancel(1, None, "a stranger cancels"),
            Clearance(random.randint(0, 5), "a stranger's box"),
            Counts((GREAT,) * self._count),
            Hello(VERSION, "operator", self._arm),
            Lock(1, 0, 1),
            PlayFault(1, "silence can0/1"),
            Program(10**9, 1, empty, 0.0, (), True, False, "a stranger's"),
            Reset(1, 1),
            Setpoint(10**9, 1, empty, (), 1e12, False, "a stranger's"),
            Trial(10**9, 1, 0, 1, 0.1, 1e12),
        ]
        if self.may_stop and random.random() < 0.2:
            return Stop(random.randint(0, 5))
        return random.choice(messages)

    def _say(self, client: ClientId, message: Down) -> None:
        self._executor.hear(client, FromClient(client, message))
