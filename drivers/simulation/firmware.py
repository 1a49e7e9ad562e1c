"""The firmware of a simulated CiA 401 board."""

from __future__ import annotations

import math
import struct
from collections import deque
from collections.abc import Callable, Sequence
from typing import NamedTuple

from canopen.sdo.server import SdoServer

from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Command, State
from hyperbit.drivers.canopen.wiring import WatchedObject
from hyperbit.drivers.simulation import lss
from hyperbit.drivers.simulation.actuator import CONTRACTED, EXTENDED, Actuator
from hyperbit.drivers.simulation.emergencies import Emergencies
from hyperbit.drivers.simulation.lss import LssSlave
from hyperbit.drivers.simulation.objects import Objects
from hyperbit.drivers.simulation.outputs import SimulatedOutputs
from hyperbit.drivers.simulation.pdos import Pdos
from hyperbit.drivers.simulation.supervision import Supervision
from hyperbit.drivers.simulation.variants import STANDARD, Variant

_MASTER_LOST, _SYNC_LOST = 0x8130, 0x8100
_EMERGENCY, _INPUTS, _ERROR_REGISTER = 0x1014, 0x6000, 0x1001
_MAKERS_ERROR = 0xFF00  # error code
_PDO_PARAMETERS = range(0x1400, 0x1C00)
_MOST_SEGMENTS, _OUT_OF_MEMORY = 64, 0x0504_0005  # most bytes of a segmented write, and the abort code above
_MOST_REQUESTS = 8  # SDO requests that wait in a board that answers slowly


class Wired(NamedTuple):
    """An actuator with the bits of its outputs and inputs; None: no such coil or switch is on this board."""

    actuator: Actuator
    output: int | None  # bit of its only coil, or of the coil that extends it
    input: int | None  # bit of the switch at the extended end
    output_off: int | None = None  # bit of the coil that contracts it
    input_contracted: int | None = None  # bit of the switch at the contracted end
    # whether the coils of `output` and `output_off` are energised while their output is 0
    inverted: tuple[bool, bool] = (False, False)
    shared: bool = False  # other boards have coils or switches of the actuator, too


class SimulatedBoard:
    """One board with NMT, supervision, SDO server, PDOs, SYNC and emergencies according to CiA 301 and 401.

    It has no I/O and no clock: `receive` takes frames, `step` takes the time, and `send` gets the COB-ID and data of
    the board's frames.
    """

    def __init__(
        self, node: int, wired: Sequence[Wired], send: Callable[[int, bytes], None], variant: Variant = STANDARD
    ) -> None:
        self.node = node
        self.wired = tuple(wired)
        self.variant = variant
        self.objects = Objects(node, variant, self._written)
        self.state: State | None = None  # NMT state; None without power, and while it starts
        # levels of inputs other than end-stops, by bit; changes take effect at the next `step`
        self.contacts: dict[int, int] = {}
        self.supplies: dict[WatchedObject, int] = {}  # values of objects that tell of something outside, likewise
        self.silent = False  # whether it is disconnected from the bus
        self.ignored = 0  # number of frames that were not understood
        # levels of the pins before and after each START that made it operational
        self.started: list[tuple[int, int]] = []
        self.emergencies = Emergencies(self.objects, self.send_emergency, logs_ends=variant.logs_ends)
        self._bus = send
        identity = [self.objects.number(0x1018, sub) for sub in range(1, 5)]
        self.lss = LssSlave(identity, node, self.send_message)
        self.outputs = SimulatedOutputs(self.objects, variant)
        self.pdos = Pdos(self.objects, self.outputs, self.emergencies, self.send_message, variant.pads)
        self._read_node()
        self._requests: deque[tuple[float, bytes]] = deque()  # SDO requests, and the times of their answers
        self._boots_at = math.inf
        self.now = 0.0
        self.inputs = 0
        for one in self.wired:
            if one.shared:  # another board may move the actuator until it arrives
                one.actuator.observers.append(self._observe)

    def _read_node(self) -> None:
        self.node = node = self.objects.node = self.lss.node
        self.sdo = self._sdo_server()
        self.supervision = Supervision(node, self.objects, self.send_message, self._lose_master, self._hear_master)

    def _sdo_server(self) -> SdoServer:
        server = SdoServer(  # type: ignore[no-untyped-call]
            cia301.SDO_REQUEST + self.node, cia301.SDO_ANSWER + self.node, self.objects
        )
        server.network = self  # type: ignore[assignment]  # the server uses only send_message of its network
        return server

    def power_on(self, now: float) -> None:
        """Starts with all outputs off."""
        self.now = now
        self._start()

    def power_cut(self, now: float) -> None:
        """Cuts the supply of board and actuators; springs return their actuators."""
        self.now = now
        self.state = None
        self._boots_at = math.inf
        self._forget()
        self.drive()

    def send_message(self, cob_id: int, data: bytes) -> None:
        """Sends a frame, unless the board is disconnected."""
        if not self.silent:
            self._bus(cob_id, bytes(data))

    @property
    def powered(self) -> bool:
        return self.state is not None or self._boots_at < math.inf

    def set_level(self, it: WatchedObject | None, bit: int, level: int) -> None:
        """Sets a bit of an object, or of the inputs, 6000h, if `it` is None. Of 1001h it begins or ends an error."""
        if it is None:
            self.contacts[bit] = level
        elif it.object != _ERROR_REGISTER:
            self.supplies[it] = self.supplies.get(it, 0) & ~(1 << bit) | level << bit
        elif level:
            self.emergencies.report(_MAKERS_ERROR + bit, 1 << bit)
        else:
            self.emergencies.recover(_MAKERS_ERROR + bit)

    def lose_tpdo(self) -> None:
        self.pdos.losing += 1

    @property
    def pins(self) -> int:
        """Levels of the output pins, to which the coils are wired; bit k is output k."""
        return self.outputs.pins(self.state) if self.powered else 0

    @property
    def timer(self) -> float:
        """Time when `step` must be called at the latest [s]."""
        answer = self._requests[0][0] if self._requests else math.inf
        actuators = [wired.actuator.due for wired in self.wired]
        return min(self._boots_at, answer, self.supervision.due, self.pdos.due, *actuators)

    def step(self, now: float) -> None:
        """Advances to `now` [s]: moves actuators, sends and checks heartbeats, answers delayed requests."""
        self.now = now
        for wired in self.wired:
            wired.actuator.step(now)
        if now >= self._boots_at:
            self._boot(0x1000, 0xFFFF)
        if self.state is None:
            return
        self._read_inputs()
        while self._requests and self._requests[0][0] <= now:
            self._serve(self._requests.popleft()[1])
        self.supervision.step(now, self.state)
        if now >= self.pdos.sync_due:
            self.pdos.forget()
            self._fall(_SYNC_LOST)
        self.pdos.repeat(now)

    def receive(self, cob_id: int, data: bytes, now: float) -> None:
        """Takes a frame with an 11 bit identifier from the bus; `now` in [s]."""
        self.now = now
        if self.state is None or self.silent:
            return
        if cob_id == cia301.NMT:
            if len(data) == 2 and data[1] in (0, self.node):
                self.obey(data[0])
        elif cob_id == self.objects.number(0x1005) & 0x7FF:
            if self.state is State.OPERATIONAL and self.pdos.sync(data, now):
                self.drive()
        elif cob_id == cia301.SDO_REQUEST + self.node:
            self._request(data)
        elif cob_id == lss.REQUEST:
            self.lss.receive(data)
        elif cob_id & ~0x7F in (cia301.HEARTBEAT, cia301.HEARTBEAT | cia301.REMOTE):
            self.supervision.hear(cob_id, data, now, self.state)
        elif self.state is State.OPERATIONAL and self.pdos.receive(cob_id, data, now):
            self.drive()

    def _forget(self) -> None:
        self.sdo = self._sdo_server()
        self.supervision.reset()
        self.pdos.forget()
        self._requests.clear()
        self.inputs = 0
        self.emergencies.reset()

    def _start(self) -> None:
        """Restarts the board as after power-on: outputs off, and a boot-up message after `boot_time`."""
        self.lss.reset()
        if self.lss.node != self.node:
            self._read_node()
        self._forget()
        self.state = None
        self.objects.reset()
        self.outputs.recover()
        self._boots_at = self.now + self.variant.boot_time
        self.drive()
        if self._boots_at <= self.now:
            self._boot(0x1000, 0xFFFF)

    def _boot(self, first_object: int, last_object: int) -> None:
        self._forget()
        self.objects.reset(first_object, last_object)
        self.pdos.configure()
        after_power_on, self._boots_at = self._boots_at < math.inf, math.inf
        self.state = State.PRE_OPERATIONAL
        self.drive()
        self._read_inputs()
        self.send_message(cia301.HEARTBEAT + self.node, bytes([State.BOOT_UP]))
        self.supervision.begin(self.now)
        if after_power_on:
            for error in self.variant.errors:
                self.emergencies.report(*error)
        else:
            self.emergencies.restore(self.variant.errors)

    def _request(self, data: bytes) -> None:
        if len(data) != 8:
            self.ignored += 1
        elif self.state is not State.STOPPED:
            if not self.variant.answer_delay:
                self._serve(data)
            elif len(self._requests) < _MOST_REQUESTS:
                self._requests.append((self.now + self.variant.answer_delay, data))

    def _serve(self, data: bytes) -> None:
        try:
            self.sdo.on_request(0, data, self.now)  # type: ignore[no-untyped-call]
        except (struct.error, TypeError):  # the server fails on a segment without a transfer
            self.ignored += 1
        if len(self.sdo._buffer or b"") > _MOST_SEGMENTS:
            self.sdo._buffer = bytearray()
            self.sdo.abort(_OUT_OF_MEMORY)  # type: ignore[no-untyped-call]

    def obey(self, order: int) -> None:
        if order == Command.START:
            if self.variant.starts or not self.objects.number(0x1001):
                self.enter(State.OPERATIONAL)
        elif order == Command.STOP:
            self.enter(State.STOPPED)
        elif order == Command.PRE_OPERATIONAL:
            self.enter(State.PRE_OPERATIONAL)
        elif order == Command.RESET_NODE:
            self._start()
        elif order == Command.RESET_COMMUNICATION:
            if not self.variant.keeps_outputs:
                self.objects.reset(self.variant.output_object, self.variant.output_object)
                self.outputs.recover()
            self._boot(0x1000, 0x1FFF)
        else:
            self.ignored += 1

    def enter(self, state: State) -> None:
        if state is self.state:
            return
        before, self.state = self.pins, state
        self.pdos.forget()
        if state is State.STOPPED:
            self.outputs.fail_safe()
        if state is State.OPERATIONAL:
            self.outputs.recover()
            self.started.append((before, self.pins))
        self.drive()
        if state is State.OPERATIONAL:
            self.emergencies.recover(_SYNC_LOST)
            self.pdos.start(self.now)

    def _hear_master(self) -> None:
        if not self.variant.keeps_loss:
            self.emergencies.recover(_MASTER_LOST)

    def _lose_master(self) -> None:
        self._fall(_MASTER_LOST)

    def _fall(self, code: int) -> None:
        """Begins the error state, and enters the NMT state of 1029h."""
        self.emergencies.report(code)
        self.outputs.fail_safe()
        self.drive()
        if (behaviour := self.objects.number(0x1029, 1)) == 0 and self.state is State.OPERATIONAL:
            self.enter(State.PRE_OPERATIONAL)
        elif behaviour == 2:
            self.enter(State.STOPPED)

    def drive(self) -> None:
        levels = self.pins
        for actuator, output, _, output_off, _, inverted, _ in self.wired:
            if output is None:
                continue
            on, off = levels >> output & 1, 0
            if output_off is not None:
                off = levels >> output_off & 1
                if self.powered:
                    on, off = on ^ inverted[0], off ^ inverted[1]
            actuator.drive(on, self.now, off)

    def _observe(self) -> None:
        if self.state is not None:
            self._read_inputs()

    def _read_inputs(self) -> None:
        for it, value in self.supplies.items():
            if (entry := self.objects.described.get(it.object, {}).get(it.sub)) is not None:
                self.objects.set_number(*it, value & (1 << 8 * entry.size) - 1)
        before, self.inputs = self.inputs, self._sense()
        if self.inputs == before:
            return
        changed = {sub: (before ^ self.inputs) >> 8 * (sub - 1) & 0xFF for sub in self.objects.subs(_INPUTS)}
        for sub in changed:
            self.objects.set_number(_INPUTS, sub, self.inputs >> 8 * (sub - 1) & 0xFF)
        if self.state is State.OPERATIONAL:
            self.pdos.publish(changed, self.now)

    def _sense(self) -> int:
        inputs = sum(level << bit for bit, level in self.contacts.items())
        for actuator, _, extended, _, contracted, _, _ in self.wired:
            if extended is not None:
                inputs |= actuator.reads(EXTENDED) << extended
            if contracted is not None:
                inputs |= actuator.reads(CONTRACTED) << contracted
        return inputs

    def send_emergency(self, data: bytes) -> None:
        cob_id = self.objects.number(_EMERGENCY)
        if self.state is not State.STOPPED and not cob_id & cia301.INVALID:
            self.send_message(cob_id & 0x7FF, data)

    def _written(self, index: int, sub: int) -> None:
        if index in _PDO_PARAMETERS:
            self.pdos.configure()
        elif index == 0x1003:
            self.emergencies.clear_history()
        elif self.outputs.written(index, sub):
            self.drive()
        else:
            self.supervision.written(index, self.now)
