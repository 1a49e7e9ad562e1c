"""Garbage collection when it does no harm: a full one stops all threads for a tenth of a second, under load longer."""

import gc

WORTH, TOO_MANY = 500, 5_000  # objects since the last collection; to look through so many takes about 3 ms


class Garbage:
    """What lives as long as the daemon is never looked through again; the rest when the control loop says so."""

    def __enter__(self) -> "Garbage":
        gc.collect()
        gc.freeze()
        gc.disable()
        return self

    def __exit__(self, *_: object) -> None:
        gc.enable()
        gc.unfreeze()

    def collect(self, idle: bool) -> None:
        """Collects all garbage if the loop is idle, else that of the youngest objects if they are too many."""
        young, older, _ = gc.get_count()
        if idle and (young > WORTH or older > 0):
            gc.collect()
        elif young > TOO_MANY:
            gc.collect(0)
