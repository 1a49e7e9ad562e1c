"""The refusal of a request: its reason, and the facts that fill the reason's sentence."""

import re
from collections.abc import Sequence
from typing import Annotated

import msgspec
from msgspec import Meta

from hyperbit.controller.refusals.reasons import Reason

WAYPOINT = re.compile(r"^(goal\.|)waypoints\[(\d+)\]\.?([^:]*)")  # the path of a field of a payload
LONGEST_SENTENCE = 1_000  # characters; also of a fact

Fact = str | int | float


class Refusal(ValueError):
    """A request that is not carried out; as a text, the sentence that says why.

    A refusal never raises another exception: a fact that is missing stays as its name in braces.

    Args:
        reason: why.
        goal: id of the goal, if it is known.
        facts: fill the sentence of the reason. Floats are shown with six digits.

    Attributes:
        goal: see above.
    """

    def __init__(self, reason: Reason, goal: str | None = None, /, **facts: Fact) -> None:
        super().__init__(reason, goal)
        self._reason, self.goal = reason, goal
        self._facts = {name: shown(fact) for name, fact in facts.items()}

    @property
    def reason(self) -> Reason:
        return self._reason

    @property
    def facts(self) -> dict[str, str]:
        return self._facts

    @property
    def code(self) -> int:
        return self.reason.code

    @property
    def data(self) -> "Refused":
        return Refused(self.reason, {name: printable(fact) for name, fact in self.facts.items()})

    def __str__(self) -> str:
        return printable(self.reason.sentence.format_map(NamedFacts(self.facts)))


class Refused(msgspec.Struct, frozen=True, array_like=True, forbid_unknown_fields=True):
    """A refusal as plain data: its reason and its facts."""

    reason: Reason
    facts: Annotated[dict[str, Annotated[str, Meta(max_length=LONGEST_SENTENCE)]], Meta(max_length=20)] = {}

    @property
    def refusal(self) -> Refusal:
        return Refusal(self.reason, **self.facts)


class NamedFacts(dict[str, str]):
    """Facts for `str.format_map`; a missing fact becomes its name in braces."""

    def __missing__(self, name: str) -> str:
        return f"{{{name}}}"


def shown(fact: Fact) -> str:
    return f"{fact:g}" if isinstance(fact, float) else str(fact)


def printable(sentence: str) -> str:
    """Returns a text with single surrogates escaped, which no message can contain; cut to LONGEST_SENTENCE."""
    sentence = sentence.encode("utf-8", "backslashreplace").decode()
    return sentence if len(sentence) <= LONGEST_SENTENCE else sentence[: LONGEST_SENTENCE - 3] + "..."


def nth_waypoint(index: int, field: str = "") -> str:
    """Returns how messages name a waypoint, or a field of it: counted from 1, as the progress of a goal."""
    return f"waypoint {index + 1}{field and f', {field}'}"


def leg(index: int) -> str:
    """Returns how messages name the way from a waypoint to the next."""
    return f"waypoint {index + 1} to {index + 2}"


def no_motion(mode: str, why: str) -> Refusal:
    """Returns the refusal of a motion by the mode of the arm, which a sentence explains."""
    match mode:
        case "starting":
            return Refusal(Reason.ARM_STARTING, why=why)
        case "fault":
            return Refusal(Reason.ARM_IN_FAULT, why=why)
        case "stopped":
            return Refusal(Reason.ARM_STOPPED, why=why)
        case _:
            return Refusal(Reason.ARM_NOT_KNOWN, mode=mode, why=why)


def no_actuator(field: str, label: str, actuators: Sequence[str]) -> Refusal:
    """Returns the refusal of a label in a field that is none of the labels of the arm."""
    quoted = repr(label if len(label) <= 60 else label[:57] + "...")
    number = label.partition(".")[0]
    module = [each for each in actuators if each.partition(".")[0] == number]
    known = f"module {number} has {', '.join(module)}" if module else f"they are {actuators[0]} to {actuators[-1]}"
    return Refusal(Reason.UNKNOWN_ACTUATOR, field=field, actuator=quoted, known=known)


def all_faults(faults: list[str]) -> str:
    """Returns the first three faults of a payload, and the number of the others, as a fact."""
    faults = [WAYPOINT.sub(lambda found: f"{found[1]}{nth_waypoint(int(found[2]), found[3])}", each) for each in faults]
    return "; ".join(faults[:3]) + (f" (and {len(faults) - 3} more faults)" if len(faults) > 3 else "")
