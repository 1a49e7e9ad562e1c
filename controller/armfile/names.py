"""Names of actuators in sentences."""

from collections.abc import Sequence

MOST_NAMED = 6


def shortened(names: Sequence[str]) -> str:
    """Joins names; of many only the first, with the number of the others."""
    return ", ".join(names[:MOST_NAMED]) + (f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else "")
