"""Sessions of the tools with the simulated boards of a world, on its clock."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import replace

from hyperbit.drivers.canopen.tools.bus_check import CheckedBoard, check_bus
from hyperbit.drivers.canopen.tools.session import Session
from hyperbit.drivers.canopen.wire.cia301 import Frame
from hyperbit.drivers.canopen.wire.events import BusChanged, Event
from hyperbit.drivers.canopen.wiring import BusWiring
from tests.drivers.rig import World


class WorldBus:
    """A bus of the world in place of a CanBus; `sent` is called with each frame that the session sends."""

    def __init__(self, world: World, wiring: BusWiring) -> None:
        self.wiring, self.name = wiring, wiring.name
        self.events: deque[Event] = deque()
        self.sent: Callable[[Frame], None] = lambda frame: None
        self._world = world

    def open(self) -> None:
        pass

    def close(self) -> None:
        self.events.clear()

    def poll(self) -> list[Event]:
        events = list(self.events)
        self.events.clear()
        return events

    def send_frame(self, frame: Frame) -> str | None:
        self.sent(frame)
        return self._world.buses[self.name].send_frame(frame)


class SessionInWorld(Session):
    """A session that takes the place of the world's master."""

    def __init__(self, world: World) -> None:
        world.run(0.05)
        world.stalled = False
        self.buses = {bus.name: WorldBus(world, bus) for bus in world.wiring.buses}
        self._world = world
        world.use(self)
        super().__init__(self.buses.values())  # type: ignore[arg-type]

    def clock(self) -> float:
        return self._world.now

    def sleep(self, seconds: float) -> None:
        self._world.run(seconds)

    def receive_event(self, event: Event, now: float) -> None:
        self.buses[event.bus].events.append(event)

    def tick(self, now: float) -> None:
        pass

    def lose(self, bus: str) -> None:
        self.buses[bus].events.append(BusChanged(bus, "down", "it is down", None))


def checked(world: World, lose: str = "", **changes: object) -> list[CheckedBoard]:
    """Checks the bus; `changes` of the wiring, `lose` is a bus that goes down."""
    with SessionInWorld(world) as asking:
        world.frames()
        if lose:
            asking.lose(lose)
        return check_bus(asking, replace(world.wiring, **changes), world.timing)
