"""Actuator states as the end-stops read them, and which of them are known."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class StateImage:
    """States of all actuators; boards write into it.

    Attributes:
        ends: states from the end-stops; 0 for actuators without one.
        known: mask of the actuators whose board is up.
    """

    ends: int = 0
    known: int = 0
