"""What is special about single devices, by their identity (1018h); nothing else in the driver names a device."""

from __future__ import annotations

from typing import NamedTuple


class Quirk(NamedTuple):
    """What is special about a device.

    Attributes:
        device: name, for messages.
        source: where this is from.
        further_rpdos: number of the first RPDO that may carry outputs beyond the first 64; RPDOs before are for analog
            outputs.
        ignored_errors: bits of the error register 1001h that this device sets without a fault.
        guarding: node guarding although it has the objects of heartbeats as well.
    """

    device: str
    source: str
    further_rpdos: int = 2
    ignored_errors: int = 0
    guarding: bool = False


NONE = Quirk("", "")

# By vendor and product (1018h sub 1 and 2); product None: all of the vendor.
QUIRKS: dict[tuple[int, int | None], Quirk] = {
    (0x21, None): Quirk(
        device="WAGO 750",
        source="manual of 750-337 and 750-338, version 3.0.2: RPDO2 to 4 are analog, digital outputs go on in RPDO5",
        further_rpdos=5,
    ),
}

VENDORS = frozenset(vendor for vendor, _ in QUIRKS)


def quirk_of(vendor: int | None, product: int | None) -> Quirk:
    """Returns what is special about a device; None stands for an identity that it does not tell."""
    if vendor is None:
        return NONE
    return QUIRKS.get((vendor, product)) or QUIRKS.get((vendor, None)) or NONE
