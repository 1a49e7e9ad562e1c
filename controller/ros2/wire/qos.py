"""Quality of service of an endpoint, as a field of its liveliness token.

Zenoh delivers between any two settings. The settings decide how this side publishes or subscribes, and what tokens say.
"""

import re
from enum import IntEnum
from typing import NamedTuple

DEFAULT_DEPTH = 42  # rmw_zenoh's; an empty field has it
DEFAULT_TIMING = ",:,:,,"


class Reliability(IntEnum):
    """Codes of rmw_qos_reliability_policy_e."""

    SYSTEM_DEFAULT = 0
    RELIABLE = 1
    BEST_EFFORT = 2
    UNKNOWN = 3
    BEST_AVAILABLE = 4


class Durability(IntEnum):
    """Codes of rmw_qos_durability_policy_e."""

    SYSTEM_DEFAULT = 0
    TRANSIENT_LOCAL = 1
    VOLATILE = 2
    UNKNOWN = 3
    BEST_AVAILABLE = 4


class History(IntEnum):
    """Codes of rmw_qos_history_policy_e."""

    SYSTEM_DEFAULT = 0
    KEEP_LAST = 1
    KEEP_ALL = 2
    UNKNOWN = 3


class BadQos(ValueError):
    pass


class Qos(NamedTuple):
    reliability: Reliability = Reliability.RELIABLE  # whether lost samples are sent again
    durability: Durability = Durability.VOLATILE  # whether a late subscriber receives the last `depth` samples
    history: History = History.KEEP_LAST  # whether `depth` limits what is kept
    depth: int = 10  # number of kept samples
    # deadline, lifespan and liveliness as in the token; empty: rmw_zenoh's default. Not applied here
    timing: str = DEFAULT_TIMING

    @property
    def transient_local(self) -> bool:
        return self.durability is Durability.TRANSIENT_LOCAL

    @property
    def reliable(self) -> bool:
        return self.reliability is not Reliability.BEST_EFFORT


DEFAULT = Qos()
SENSOR_DATA = Qos(Reliability.BEST_EFFORT, depth=5)
LATCHED = Qos(durability=Durability.TRANSIENT_LOCAL, depth=1)  # robot_description, maps, status of an action
TF = Qos(depth=100)
TF_STATIC = Qos(durability=Durability.TRANSIENT_LOCAL, depth=100)
CLOCK = Qos(Reliability.BEST_EFFORT, depth=1)

DEFAULTS = (Reliability.RELIABLE, Durability.VOLATILE, History.KEEP_LAST, DEFAULT_DEPTH)
NUMBER = r"(\d{0,18})"
FORM = re.compile(rf"{NUMBER}:{NUMBER}:{NUMBER},{NUMBER}:(\d*,\d*:\d*,\d*:\d*,\d*,\d*)", re.ASCII)


def encode(qos: Qos) -> str:
    """Returns the field of a token. A value equal to rmw_zenoh's default is left empty."""
    values = (qos.reliability, qos.durability, qos.history, qos.depth)
    reliability, durability, history, depth = (
        "" if value == default else str(int(value)) for value, default in zip(values, DEFAULTS, strict=True)
    )
    return f"{reliability}:{durability}:{history},{depth}:{qos.timing}"


def parse(text: str) -> Qos:
    """Parses a token's field. Raises BadQos if the text has another form."""
    if not (match := FORM.fullmatch(text)):
        raise BadQos(f"{text!r} is no quality of service: expected one such as '::,10:,:,:,,'")
    numbers = [int(it) if it else default for it, default in zip(match.groups()[:4], DEFAULTS, strict=True)]
    try:
        return Qos(Reliability(numbers[0]), Durability(numbers[1]), History(numbers[2]), numbers[3], match[5])
    except ValueError as error:
        raise BadQos(f"{text!r} is no quality of service: {error}") from None
