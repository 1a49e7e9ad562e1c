"""Frames that only a master sends, from another node: of another master, or of a device with the master's node id."""

from __future__ import annotations

from hyperbit.drivers.canopen.faults import ArmFault
from hyperbit.drivers.canopen.run.heartbeat import BEAT
from hyperbit.drivers.canopen.wire import cia301
from hyperbit.drivers.canopen.wire.cia301 import Frame
from hyperbit.drivers.canopen.wiring import MASTER

_OWN = {cia301.NMT: "NMT", cia301.SYNC: "SYNC", BEAT.id: "the master's heartbeat"}


def find_intruder(bus: str, frame: Frame, is_rpdo: bool) -> ArmFault | None:
    """Returns the fault of a frame of another node. `is_rpdo`: the frame has the COB-ID of an RPDO of this bus."""
    what = _OWN.get(frame.id, "an RPDO" if is_rpdo else None)
    if what is None:
        return None
    here, device = f"frame {frame.id:03X}h", f"a device on {bus} has node id {MASTER}"
    if frame.id == BEAT.id and frame.data != BEAT.data:
        text = f"{device}, which is hyperbit's own ({here}): give it another one: hyperbit node-id"
        return ArmFault("duplicate-node", bus, text)
    text = f"another master sends on {bus} ({what}, {here}): stop it, only one may switch the boards"
    if frame.id == BEAT.id:
        text += f"; or {device}: give it another one (hyperbit node-id)"
    return ArmFault("foreign-master", bus, text)
