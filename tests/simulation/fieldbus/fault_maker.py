"""What all makers of single faults have: one drawn board with its bus."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from tests.simulation.fieldbus.expected import Makers

if TYPE_CHECKING:
    from tests.simulation.fieldbus.world import BoardWorld

Action = Callable[[], None]


class FaultMaker:
    """Makes faults of one drawn board. Each public method of a subclass makes one; None: it cannot happen."""

    def __init__(self, world: BoardWorld) -> None:
        self._world, self._random, self._site = world, world.random, world.site
        self._name = world.random.choice(list(world.looks))
        self._board = world.site.board(self._name)
        self._judged = world.wiring.boards[self._name]
        self._bus = world.site.buses[self._judged.bus]
        self._timing = world.drawn.timing
        self._here = tuple(name for name, b in world.wiring.boards.items() if b.bus == self._bus.name)

    @classmethod
    def of(cls, world: BoardWorld) -> Makers:
        maker = cls(world)
        return {name.replace("_", " "): getattr(maker, name) for name in vars(cls) if not name.startswith("_")}

    def _nothing(self) -> None:
        """Mends a fault that is over at once."""

    def _fault(self, verb: str) -> Action:
        return lambda: self._site.boards.fault(verb, self._name)

    def _status(self) -> Any:
        [status] = [s for s in self._world.master.status().boards if f"{s.bus}/{s.node}" == self._name]
        return status

    def _bus_status(self) -> Any:
        [status] = [s for s in self._world.master.status().buses if s.name == self._bus.name]
        return status

    def _intercept_nothing(self) -> None:
        self._site.intercept = lambda bus, frame: ""

    def _numbers(self, index: int, sub: int) -> Callable[[int], Action]:
        return lambda value: lambda: self._board.objects.set_number(index, sub, value)
