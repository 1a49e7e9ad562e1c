"""The table of faults: how each begins and ends, where it strikes, and what must be told of it.

A row makes a `Fault` of a drawn place, or None where it cannot strike. All worlds draw from the table.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from random import Random
from typing import Any, NamedTuple
from zlib import crc32

from hyperbit.drivers.canopen.wire.cia301 import Frame
from hyperbit.drivers.canopen.wire.events import Event, FrameReceived
from hyperbit.drivers.canopen.wiring import Timing, Wiring
from tests.simulation.agenda import Agenda
from tests.simulation.buses.boards import AttachedBoards
from tests.simulation.buses.bus_model import BusModel
from tests.simulation.faults.sight import Sight

AT_ONCE = 0.06  # [s] until a frame, or a change of a bus, is told
GOLDEN = 0.618034  # successive seeds begin at places that are evenly spread over the table


class Told(NamedTuple):
    """What must be told of a fault that comes alone, while all boards are ready and nothing else is wrong.

    Attributes:
        codes: one of them must be told; none: nothing may be told.
        sources: of which one is its source, perhaps with its place in brackets.
        words: in its message.
        within: [s] from the begin until it is told.
        also: codes that may be told as well.
        clears: whether the arm becomes ready without a reset when the fault is over.
        warns: whether it is only a warning, which ends with the fault.
        lost: boards whose states become unknown.
        beats: whether the executor's heartbeats go on.
        least: [s] before which nothing may be told.
        locks: label of an actuator, and whether it is locked when the arm is ready again; None: nothing is judged.
        asks: whether the executor must ask the planner about a stage.
        refused: reason for which a reset is refused while the fault lasts; "" if it is not.
    """

    codes: tuple[str, ...] = ()
    sources: tuple[str, ...] = ()
    words: tuple[str, ...] = ()
    within: float = 0.2
    also: tuple[str, ...] = ()
    clears: bool = False
    warns: bool = False
    lost: tuple[str, ...] = ()
    beats: bool = True
    least: float = 0.0
    locks: tuple[str, bool] | None = None
    asks: bool = False
    refused: str = ""


NOTHING = Told()


def nothing() -> None:
    """Ends a fault that is over at once."""


class Fault(NamedTuple):
    """A fault at a place. Without `told` nobody can say what it leads to.

    Attributes:
        check: what worlds of boards judge beside, when the fault was told.
        holds: neither the fault nor the reset after it changes what it returns.
    """

    begin: Callable[[], object]
    end: Callable[[], object] = nothing
    told: Told | None = NOTHING
    check: Callable[[], object] = nothing
    holds: Callable[[], object] = nothing


class Place:
    """Where a fault strikes: a drawn board, its bus, and an actuator with outputs on it.

    Attributes:
        world: also for faults of one kind of world.
        name: of the board; `here`: names of all boards on its bus.
        judged: what the arm's file says of the board.
        k: number of the actuator.
    """

    def __init__(self, world: Any, random: Random) -> None:
        self.world, self.random = world, random
        self.agenda: Agenda = world.agenda
        self.boards: AttachedBoards = world.boards
        self.buses: Mapping[str, BusModel] = world.buses
        self.wiring: Wiring = world.wiring
        self.timing: Timing = world.timing
        self.name = random.choice(self.boards.simulated.names)
        bus, node = self.name.split("/")
        self.bus, self.node = self.buses[bus], int(node)
        self.board = self.boards.simulated.board(self.name)
        self.objects = self.board.objects
        self.here = tuple(name for name in self.boards.simulated.names if name.startswith(f"{bus}/"))
        self.sight: Sight = world.sight
        self.judged = self.sight.wiring.boards[self.name]
        channels = self.wiring.channels
        wired = [k for k, channel in enumerate(channels) if (channel.bus, channel.node) == (bus, self.node)]
        self.k = random.choice(wired or range(len(channels)))
        self.channel = channels[self.k]

    @property
    def turn(self) -> float:
        """Time in which all objects of the board are read once [s]."""
        return self.sight.turn(self.name)

    @property
    def guarded(self) -> bool:
        """Whether node guarding supervises the board."""
        return not (self.objects.has(0x1016) and self.objects.has(0x1017))

    @property
    def period(self) -> float:
        """Time between two signs of life of the board [s]."""
        return self.timing.heartbeat if self.guarded else self.objects.number(0x1017) / 1000

    def after(self, delay: float, happen: Callable[[], None]) -> None:
        self.agenda.after(delay, happen)

    def tell(self, event: Event) -> Callable[[], None]:
        return lambda: self.world.tell(event)

    def post(self, frame: Frame) -> Callable[[], None]:
        """Returns what makes the executor hear a frame, and nobody else."""
        return self.tell(FrameReceived(self.bus.name, frame, None))

    def do(self, verb: str, *numbers: float | str, of: str = "") -> Callable[[], None]:
        """Returns a fault of the simulated boards."""
        return lambda: self.boards.fault(verb, of or self.name, *numbers)

    def on_bus(self, name: str, value: object) -> Callable[[], None]:
        return lambda: setattr(self.bus, name, value)

    def number(self, index: int, sub: int, value: int) -> Callable[[], None]:
        return lambda: self.objects.set_number(index, sub, value)

    def intercept(self, what: Callable[[Frame], str]) -> Callable[[], None]:
        return self.on_bus("intercept", what)

    def is_answer(self, frame: Frame) -> bool:
        return frame.id == 0x580 + self.node


class Switch(NamedTuple):
    """A command that switches an output without a pulse.

    Attributes:
        place: index and sub-index of its byte.
        late: [s] until the actuator should have moved, or until slow boards have answered.
        label: of the actuator; `also`: codes that its supervision may tell.
    """

    begin: Callable[[], object]
    place: tuple[int, int]
    late: float
    label: str = ""
    also: tuple[str, ...] = ()


Maker = Callable[[Any], Fault | None]


class Row(NamedTuple):
    """A row of the table.

    Attributes:
        strikes: "bus", "board", "actuator", "executor", "planner" or "clients".
        anytime: whether it may come beside others, and while the arm moves, boots or ends.
        longest: [s] for which it lasts then.
    """

    name: str
    make: Maker
    strikes: str
    anytime: bool
    longest: float


TABLE: dict[str, Row] = {}


def row(strikes: str, *, anytime: bool = False, longest: float = 1.0) -> Callable[[Maker], Maker]:
    """Adds a function to the table; its name is that of the fault."""

    def add(make: Maker) -> Maker:
        name = make.__name__.replace("_", " ")
        TABLE[name] = Row(name, make, strikes, anytime, longest)
        return make

    return add


class Deck:
    """Draws each of some rows as often as the others; `seed` decides which one comes first."""

    def __init__(self, rows: Iterable[Row], random: Random, seed: int) -> None:
        self.made: Counter[str] = Counter()
        self._rows, self._random, self._seed = list(rows), random, seed

    def draw(self, world: Any, alone: bool) -> tuple[Row, Fault] | None:
        """Returns a row that can strike now, with its fault; `alone`: of which somebody can say what is told."""
        for one in sorted(self._rows, key=self._turn):
            fault = one.make(Place(world, self._random))
            if fault is not None and (fault.told is not None or not alone):
                self.made[one.name] += 1
                return one, fault
        return None

    def _turn(self, one: Row) -> tuple[int, float]:
        return self.made[one.name], (crc32(one.name.encode()) / 2**32 + self._seed * GOLDEN) % 1.0
