"""Clients that ask for the errors of boards."""

from hyperbit.controller import program
from hyperbit.controller.executor.core.clients import Clients
from hyperbit.controller.executor.core.events import ClientId
from hyperbit.drivers.canopen.faults import ArmFault
from hyperbit.drivers.canopen.run.master import Master
from hyperbit.drivers.canopen.wiring import Wiring


class BoardErrorRequests:
    """Has the master read errors, and answers those who asked."""

    def __init__(self, wiring: Wiring, master: Master, clients: Clients) -> None:
        self._boards = [str(board) for board in wiring.boards]
        self._master, self._clients = master, clients
        self.waiting: dict[int, dict[ClientId, int]] = {}  # request of each client, by index of the board

    def receive(self, client: ClientId, message: program.ReadErrors) -> None:
        if message.board not in self._boards:
            why = f"{message.board[:100]!r} is no board of this arm, which has {', '.join(self._boards)[:800]}"
            self._clients.send(client, program.BoardErrors(message.request, why))
            return
        i = self._boards.index(message.board)
        self.waiting.setdefault(i, {})[client] = message.request
        self._master.errors.ask(i)

    def answer(self) -> None:
        """Answers the requests whose boards were read. Call at each tick while some wait."""
        for i, found in self._master.errors.drain():
            for client, request in self.waiting.pop(i, {}).items():
                if client not in self._clients.roles:
                    continue
                if isinstance(found, ArmFault):
                    told = program.BoardErrors(request, found.message[:1_000])
                else:
                    told = program.BoardErrors(request, "", found.register, found.history, found.complete)
                self._clients.send(client, told)
