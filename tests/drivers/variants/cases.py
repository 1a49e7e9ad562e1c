"""The expected result of each variant of the simulated boards: it boots and switches, or is refused."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

from hyperbit.drivers.canopen.wiring import Channel, Interlock, NodeWiring, Timing, WatchedObject
from tests.drivers.rig import World

_NONE: Mapping[str, Any] = MappingProxyType({})


class Case(NamedTuple):
    """A board of one variant, and its settings in the arm's file.

    Attributes:
        refused: words of the refusal's sentence; empty: the board boots and switches.
        channels: its actuators in boots with one failure; empty: two, of which one has both end-stops.
        foreign: output bits that no actuator uses, and that another program has switched on.
        foreign_holds: whether they hold in the error state (6206h).
    """

    variant: str
    refused: tuple[str, ...] = ()
    warned: tuple[str, ...] = ()
    options: Mapping[str, Any] = _NONE
    label: str = ""
    timing: Timing = Timing(boot_timeout=8.0)
    channels: tuple[Channel, ...] = ()
    foreign: int = 0
    foreign_holds: bool = False

    @property
    def name(self) -> str:
        return f"{self.variant}-{self.label}" if self.label else self.variant

    def world(self) -> World:
        """A master, and the board as can0/5 with two actuators: one with both end-stops, one without any."""
        far = 64 if self.variant == "many-outputs" else 1
        channels = [Channel("5.left", "can0", 5, 0, 0, input_contracted=1), Channel("5.right", "can0", 5, far, None)]
        return World(channels, self.timing, variant=self.variant, **self.options)


_CONTRACT, _HOLD, _OFF = {"on_loss": "contract"}, {"error_state": "hold"}, {"error_state": "off"}
_ODD = Timing(boot_timeout=8.0, heartbeat=0.088, heartbeat_timeout=0.355)
_DEVICE = {"error_state": "device"}
_MAKER = {"nodes": (NodeWiring("can0", 5, object=0x2201, error_state="off"),)}
_MAKER_UNKNOWN = {"nodes": (NodeWiring("can0", 5, object=0x2201),)}
_NO_MODE = ("has no 6206h (error mode)", "set boards.error_state to off, hold or device")
_NO_BEHAVIOUR = "has no 1029h sub 1 (error behaviour); CiA 301 makes it enter pre-operational when the master is lost"
_NO_BEHAVIOUR_REFUSED = ("has no 1029h sub 1 (error behaviour); 02h is needed", "on_loss: contract")
_NO_VALUE_REFUSED = ("has no 6207h sub 1 (error value); 00h is needed", "on_loss: contract")
_SUPPLY = {"interlocks": (Interlock("supply", "can0", 5, 0, watched=WatchedObject(0x2102, 0)),)}
_NINTH_BIT = {"interlocks": (Interlock("supply", "can0", 5, 8, watched=WatchedObject(0x2102, 0)),)}
_GOES_OFF = "by the arm's file (error_state) its outputs go off"

IN_VAIN = "did not become operational within 8 s; it is pre-operational"  # which only a start can tell

CASES = (
    Case("standard"),
    Case("standard", options=_CONTRACT, label="contract"),
    Case("guarding-only", warned=(_NO_BEHAVIOUR,)),
    Case("guarding-only", _NO_BEHAVIOUR_REFUSED, options=_CONTRACT, label="contract"),
    Case("guarding-with-1029h"),
    Case("guarding-with-1029h", options=_CONTRACT, label="contract"),
    Case("rounded-guarding", warned=(_NO_BEHAVIOUR,)),
    Case("rounded-heartbeats", timing=_ODD),
    Case("watched-already"),
    Case("one-supervision"),
    Case("unsupervised", ("neither 1016h sub 1 and 1017h (heartbeats) nor 100Ch and 100Dh (node guarding)",)),
    Case("outputs-in-rpdo5"),
    Case("many-outputs"),
    Case("fixed-mapping"),
    Case("short-mapping"),
    Case("no-sync", warned=("RPDO1 refuses to wait for SYNC (1400h sub 2)",)),
    Case("saves-writes"),
    Case(
        "no-output-bit",
        warned=(
            "1000h sub 0 is 00000191h, without the bit of digital outputs",
            "1000h sub 0 is 00000191h, without the bit of digital inputs",
        ),
    ),
    Case("no-device-type", warned=("1000h", "00000000h")),
    Case("many-profiles", warned=("1000h", "0000FFFFh")),
    Case("all-bits"),
    Case("maker-object", ("has 00000000h in 1000h sub 0 (device type), not the profile 0191h", "needs `object`")),
    Case(
        "maker-object",
        ("no error mode for its maker's object", "set boards.error_state"),
        (),
        _MAKER_UNKNOWN,
        "unknown",
    ),
    Case("maker-object", (), ("no error mode for its maker's object 2201h; by the arm's file",), _MAKER, "named"),
    Case("no-error-mode", _NO_MODE),
    Case(
        "no-error-mode", (), ("no 6206h (error mode); by the arm's file (error_state) its outputs hold",), _HOLD, "hold"
    ),
    Case("no-error-mode", _NO_VALUE_REFUSED, (), {**_HOLD, **_CONTRACT}, "contract"),
    Case("no-error-mode-off", _NO_MODE),
    Case("no-error-mode-off", (), (_GOES_OFF,), _OFF, "off"),
    Case("no-error-mode-off", (), (_GOES_OFF,), {**_OFF, **_CONTRACT}, "contract"),
    Case("off-in-preoperational", _NO_MODE),
    Case("off-in-preoperational", (), (_GOES_OFF,), _OFF, "off"),
    Case("off-in-preoperational", (), ("do what the device is set to",), _DEVICE, "device"),
    Case("off-in-preoperational", (), (_GOES_OFF,), {**_OFF, **_CONTRACT}, "contract"),
    Case("no-error-behaviour", warned=(_NO_BEHAVIOUR,)),
    Case("no-error-behaviour", _NO_BEHAVIOUR_REFUSED, options=_CONTRACT, label="contract"),
    Case("canopennode", _NO_MODE),
    Case("canopennode", (), (_NO_BEHAVIOUR, "do what the device is set to"), _DEVICE, "device"),
    Case("canopennode", (), (_NO_BEHAVIOUR, _GOES_OFF), _OFF, "off"),
    Case("canopennode", (), (_GOES_OFF,), {**_OFF, **_CONTRACT}, "contract"),
    Case("canopennode", _NO_VALUE_REFUSED, (), _CONTRACT, "undeclared"),
    Case("deaf-error-mode", ("has FFh in 6206h sub 1 (error mode) after FCh was written",)),
    Case("absent-unsupported"),
    Case("absent-general"),
    Case("logged-ends"),
    Case("logged-ends", options=_CONTRACT, label="contract"),
    Case("shows-error-state"),
    Case("shows-error-state", options=_CONTRACT, label="contract"),
    Case("resets-outputs"),
    Case("slow-answers"),
    Case("late-boot"),
    Case("foreign-sync"),
    Case("sync-counter"),
    Case("sync-period"),
    Case("sync-window"),
    Case("no-emergencies"),
    Case("padded-tpdo"),
    Case("kept-loss"),
    Case("kept-loss", options=_CONTRACT, label="contract"),
    Case("kept-loss-without-history"),
    Case("valve-supply", options=_SUPPLY),
    Case("valve-supply", ("has 8 bits in 2102h sub 0", "needs its bit 8"), options=_NINTH_BIT, label="ninth-bit"),
    Case("mapped-supply", options=_SUPPLY),
    Case("inverted-outputs", ("has FFh in 6202h sub 1 (polarity of the outputs); FCh is needed",)),
    Case("masked-inputs"),
    Case("standing-error", ("error register 1001h sub 0 is 80h; 00h is needed", "1003h sub 1 is 0000FF00h", "FF00h")),
    Case("generic-error", ("error register 1001h sub 0 is 01h; 00h is needed", "1003h sub 1 is 00001000h")),
    Case("blocking-error", (IN_VAIN, "error register 1001h sub 0 is 01h; 00h is needed", "1003h sub 1 is 00005000h")),
)
UNSEEN_WITHOUT_WRITING = frozenset({"no-sync", "deaf-error-mode"})  # `check --bus` writes present values only


def case_of(name: str) -> Case:
    return next(case for case in CASES if case.name == name)
