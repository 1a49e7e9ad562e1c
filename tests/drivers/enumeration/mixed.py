"""Boards that mix outputs of all kinds: one or two coils, inverted, pulses, both `on_loss`, and foreign bits."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from hyperbit.drivers.canopen.wiring import Channel
from tests.drivers.enumeration.bench import BUS, NODE
from tests.drivers.variants.cases import Case

ONE_INVERTED, BOTH_INVERTED = frozenset({"output"}), frozenset({"output", "output_off"})
KINDS: Mapping[str, Mapping[str, Any]] = {  # "2": with two coils; the fields of `Channel`
    "hold": {"on_loss": "hold"},
    "contract": {"on_loss": "contract"},
    "hold inverted": {"on_loss": "hold", "inverted": ONE_INVERTED},
    "contract inverted": {"on_loss": "contract", "inverted": ONE_INVERTED},
    "2 hold": {"on_loss": "hold"},
    "2 contract": {"on_loss": "contract"},
    "2 hold inverted": {"on_loss": "hold", "inverted": BOTH_INVERTED},
    "2 contract inverted": {"on_loss": "contract", "inverted": ONE_INVERTED},
    "2 pulse": {"on_loss": "hold", "pulse": 0.05},
    "2 pulse inverted": {"on_loss": "hold", "pulse": 0.05, "inverted": BOTH_INVERTED},
}


def channels(kinds: Iterable[str]) -> tuple[Channel, ...]:
    found, bit = [], 0
    for i, kind in enumerate(kinds, 1):
        two = kind.startswith("2")
        off = bit + 1 if two else None
        found.append(Channel(f"{i}.{kind}", BUS, NODE, bit, None, output_off=off, **KINDS[kind]))
        bit += 2 if two else 1
    return tuple(found)


def mixed(number: int, kinds: tuple[str, ...], foreign: int, variant: str = "standard", **more: Any) -> Case:
    return Case(variant, label=f"mixed-{number}", channels=channels(kinds), foreign=foreign, **more)


_OFF, _DEVICE = {"error_state": "off"}, {"error_state": "device"}
MIXED = (
    mixed(1, ("hold", "contract"), 0x80),
    mixed(2, ("hold", "contract", "2 hold", "2 pulse"), 0xC0, foreign_holds=True),
    mixed(3, ("2 pulse", "hold inverted", "contract", "2 contract"), 0x40),
    mixed(4, ("contract inverted", "2 hold inverted", "hold", "2 contract"), 0x80, foreign_holds=True),
    mixed(5, ("2 pulse inverted", "hold", "2 contract inverted", "hold inverted"), 0xC0, foreign_holds=True),
    mixed(6, ("hold", "2 pulse", "contract inverted", "2 hold", "contract", "hold"), 0, "many-outputs"),
    mixed(7, ("hold", "contract", "2 hold", "2 pulse"), 0xC0, "shows-error-state", foreign_holds=True),
    mixed(8, ("hold inverted", "2 contract", "2 pulse inverted", "hold"), 0x40, "guarding-with-1029h"),
    mixed(9, ("2 hold", "contract", "hold inverted", "2 pulse"), 0x80, "no-sync", foreign_holds=True),
    mixed(10, ("hold", "contract", "2 pulse", "contract"), 0x40, "no-error-mode-off", options=_OFF),
    mixed(11, ("hold", "2 hold", "2 hold", "hold"), 0x80, "off-in-preoperational", options=_DEVICE),
    mixed(12, ("2 pulse", "hold", "contract"), 0xC0, "logged-ends", foreign_holds=True),
    mixed(13, ("hold", "contract", "2 hold", "2 pulse"), 0xC0, "outputs-in-rpdo5"),
)
