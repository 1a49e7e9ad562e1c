"""The firmware of a simulated CiA 401 board, on the far side of the bus."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import NamedTuple

from canopen.sdo.server import SdoServer

from drivers.canopen import cia301
from drivers.canopen.cia301 import Command, State
from drivers.simulation.actuator import Actuator
from drivers.simulation.emergencies import Emergencies
from drivers.simulation.objects import Objects

_BYTES = range(1, 9)  # sub-indices of 6000h and 6200h
_TOO_SHORT, _TOO_LONG, _MASTER_LOST = 0x8210, 0x8220, 0x8130
_MOST_SEGMENTS, _OUT_OF_MEMORY = 64, 0x0504_0005  # bytes written in segments, and the abort code beyond


class Wired(NamedTuple):
    """An actuator on a bit of the outputs, its end-stop on one of the inputs, if it has any."""

    actuator: Actuator
    output: int
    input: int | None


class SimulatedBoard:
    """One board: network management, heartbeats, SDO server, PDOs, SYNC and emergencies as CiA 301 and 401 have them.

    It does nothing by itself: frames come by `receive`, time by `step`, and what it says goes to `send`.

    Args:
        node: its node id.
        wired: its actuators.
        send: takes COB-ID and data.

    Attributes:
        state: of the network management; None without power.
        silent: cut off from the bus, neither heard nor hearing.
        ignored: frames that made no sense.
    """

    def __init__(self, node: int, wired: Sequence[Wired], send: Callable[[int, bytes], None]) -> None:
        self.node = node
        self.wired = tuple(wired)
        self.objects = Objects(node, self._written)
        self.state: State | None = None
        self.silent = False
        self.ignored = 0
        self._bus = send
        self._sdo = SdoServer(  # type: ignore[no-untyped-call]
            cia301.SDO_REQUEST + node, cia301.SDO_ANSWER + node, self.objects
        )
        self._sdo.network = self  # type: ignore[assignment]  # of a network, the server uses nothing but send_message
        self._emergencies = Emergencies(self.objects, self._send_emergency)
        self._now = 0.0
        self._next_heartbeat: float | None = None
        self._master_deadline: float | None = None
        self._latched: bytes | None = None  # what the next SYNC switches
        self._published: bytes | None = None  # what the last TPDO carried
        self._inputs = 0

    def power_on(self, now: float) -> None:
        """Starts with all outputs off."""
        self._now = now
        self._boot(0x1000)

    def power_cut(self, now: float) -> None:
        """Takes the supply away from board and actuators; their springs contract them."""
        self._now = now
        self.state = None
        self._forget()
        self._drive()

    def send_message(self, cob_id: int, data: bytes) -> None:
        """Sends a frame, if it can."""
        if not self.silent:
            self._bus(cob_id, bytes(data))

    @property
    def timer(self) -> float:
        """When `step` is to be called at the latest [s]."""
        times = [self._next_heartbeat, self._master_deadline, *(w.actuator.due for w in self.wired)]
        return min((time for time in times if time is not None), default=float("inf"))

    def step(self, now: float) -> None:
        """Does what time brings: actuators arrive, heartbeats are due or missing; `now` in [s]."""
        self._now = now
        for wired in self.wired:
            wired.actuator.step(now)
        if self.state is None:
            return
        self._read_inputs()
        if self._next_heartbeat is not None and now >= self._next_heartbeat:
            self.send_message(cia301.HEARTBEAT + self.node, bytes([self.state]))
            self._next_heartbeat = now + self.objects.number(0x1017) / 1000
        if self._master_deadline is not None and now >= self._master_deadline:
            self._lose_master()

    def receive(self, cob_id: int, data: bytes, now: float) -> None:
        """Takes a data frame with an 11 bit identifier from the bus; `now` in [s]."""
        self._now = now
        if self.state is None or self.silent:
            return
        if cob_id == cia301.NMT:
            if len(data) == 2 and data[1] in (0, self.node):
                self._obey(data[0])
        elif cob_id == cia301.SYNC:
            if self.state is State.OPERATIONAL and self._latched is not None:
                self._write_outputs(self._latched)
            self._latched = None
        elif cob_id == cia301.SDO_REQUEST + self.node:
            self._serve(cob_id, data)
        elif cob_id == self.objects.number(0x1400, 1) and self.state is State.OPERATIONAL:
            self._receive_outputs(data)
        elif cob_id == cia301.HEARTBEAT + (self.objects.number(0x1016, 1) >> 16 & 0x7F) and len(data) == 1:
            self._hear_master()

    def _forget(self) -> None:
        self._next_heartbeat = self._master_deadline = None
        self._latched = self._published = None
        self._inputs = 0
        self._emergencies.reset()

    def _boot(self, first_object: int, last_object: int = 0xFFFF) -> None:
        self._forget()
        self.objects.reset(first_object, last_object)
        self.state = State.PRE_OPERATIONAL
        self._drive()
        self.send_message(cia301.HEARTBEAT + self.node, bytes([State.BOOT_UP]))

    def _serve(self, cob_id: int, data: bytes) -> None:
        if len(data) != 8:
            self.ignored += 1
        elif self.state is not State.STOPPED:
            try:
                self._sdo.on_request(cob_id, data, self._now)  # type: ignore[no-untyped-call]
            except (struct.error, TypeError):  # the server fails on a segment of a transfer that never began
                self.ignored += 1
            if len(self._sdo._buffer or b"") > _MOST_SEGMENTS:
                self._sdo._buffer = bytearray()
                self._sdo.abort(_OUT_OF_MEMORY)  # type: ignore[no-untyped-call]

    def _obey(self, order: int) -> None:
        if order == Command.START:
            self._enter(State.OPERATIONAL)
        elif order == Command.STOP:
            self._enter(State.STOPPED)
        elif order == Command.PRE_OPERATIONAL:
            self._enter(State.PRE_OPERATIONAL)
        elif order == Command.RESET_NODE:
            self._boot(0x1000)
        elif order == Command.RESET_COMMUNICATION:
            self._boot(0x1000, 0x1FFF)
        else:
            self.ignored += 1

    def _enter(self, state: State) -> None:
        if state is not self.state:
            self.state = state
            self._latched = self._published = None
            if state is State.STOPPED:
                self._fail_safe()
            self._publish()

    def _hear_master(self) -> None:
        period = (self.objects.number(0x1016, 1) & 0xFFFF) / 1000
        self._master_deadline = self._now + period if period else None
        self._emergencies.recover(_MASTER_LOST)

    def _lose_master(self) -> None:
        self._master_deadline = None
        self._emergencies.report(_MASTER_LOST)
        self._fail_safe()
        if (behaviour := self.objects.number(0x1029, 1)) == 0 and self.state is State.OPERATIONAL:
            self._enter(State.PRE_OPERATIONAL)
        elif behaviour == 2:
            self._enter(State.STOPPED)

    def _fail_safe(self) -> None:
        """Outputs take their error value where the error mode says so; 6200h then tells what they are."""
        for sub in _BYTES:
            mode, value = (self.objects.number(index, sub) for index in (0x6206, 0x6207))
            self.objects.put(0x6200, sub, self.objects.number(0x6200, sub) & ~mode | value & mode)
        self._drive()

    def _receive_outputs(self, data: bytes) -> None:
        length = sum(bits for *_, bits in self.objects.mapping(0x1400)) // 8
        if len(data) < length:
            self._emergencies.report(_TOO_SHORT)
            return
        if len(data) > length:  # what is mapped is taken all the same
            self._emergencies.report(_TOO_LONG)
        else:
            self._emergencies.recover(_TOO_SHORT)
            self._emergencies.recover(_TOO_LONG)
        if self.objects.number(0x1400, 2) <= 240:
            self._latched = data
        else:
            self._write_outputs(data)

    def _write_outputs(self, data: bytes) -> None:
        value = int.from_bytes(data, "little")
        for index, sub, bits in self.objects.mapping(0x1400):
            if index == 0x6200:
                self.objects.put(index, sub, value & 0xFF)
            value >>= bits
        self._drive()

    def _drive(self) -> None:
        for actuator, output, _ in self.wired:
            levels = self.objects.number(0x6200, 1 + output // 8) ^ self.objects.number(0x6202, 1 + output // 8)
            actuator.drive(levels >> output % 8 & 1 if self.state is not None else 0, self._now)

    def _read_inputs(self) -> None:
        before = self._inputs
        self._inputs = inputs = sum(actuator.reads(1) << bit for actuator, _, bit in self.wired if bit is not None)
        if inputs != before:
            for sub, value in zip(_BYTES, inputs.to_bytes(len(_BYTES), "little"), strict=True):
                self.objects.put(0x6000, sub, value)
            self._publish()

    def _publish(self) -> None:
        """Sends the TPDO if what it carries changed."""
        cob_id = self.objects.number(0x1800, 1)
        if self.state is not State.OPERATIONAL or cob_id & cia301.INVALID or not self.objects.number(0x6005):
            return
        data = bytes(self.objects.number(index, sub) for index, sub, _ in self.objects.mapping(0x1800))
        if data != self._published:
            self._published = data
            self.send_message(cob_id & 0x7FF, data)

    def _send_emergency(self, data: bytes) -> None:
        if self.state is not State.STOPPED:
            self.send_message(cia301.EMERGENCY + self.node, data)

    def _written(self, index: int, sub: int) -> None:
        if index == 0x1017:
            period = self.objects.number(0x1017) / 1000
            self._next_heartbeat = self._now + period if period else None
        elif index == 0x1016:
            self._master_deadline = None  # monitoring begins with the next heartbeat heard
        elif index == 0x1003:
            self._emergencies.clear_history()
        elif index in (0x6200, 0x6202):
            self._drive()
