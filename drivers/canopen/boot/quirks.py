"""Peculiarities of devices, by their identity 1018h. No other file of the driver names a device."""

from __future__ import annotations

from typing import NamedTuple


class Quirk(NamedTuple):
    device: str  # name, for messages
    source: str  # document with this information
    further_rpdos: int = 2  # first RPDO that may carry outputs after the first 64; lower ones carry analog outputs
    ignored_errors: int = 0  # bits of 1001h that the device sets without a fault
    guarding: bool = False  # use node guarding although the device has the objects of heartbeats


NONE = Quirk("", "")

# By vendor and product, 1018h sub 1 and 2; product None: all products of the vendor.
QUIRKS: dict[tuple[int, int | None], Quirk] = {
    (0x21, None): Quirk(
        device="WAGO 750",
        source="manual of 750-337 and 750-338, version 3.0.2: RPDO2 to 4 are analog, digital outputs go on in RPDO5",
        further_rpdos=5,
    ),
}

VENDORS = frozenset(vendor for vendor, _ in QUIRKS)


def quirk_of(vendor: int | None, product: int | None) -> Quirk:
    """Returns the peculiarities of a device; None: the device lacks this number."""
    if vendor is None:
        return NONE
    return QUIRKS.get((vendor, product)) or QUIRKS.get((vendor, None)) or NONE
