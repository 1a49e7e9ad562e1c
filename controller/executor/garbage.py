"""Garbage collection at times when it does no harm: a full collection stops the loop for milliseconds."""

import gc

WORTH, TOO_MANY = 500, 5_000  # objects since the last collection; to collect so many takes about 3 ms


class Garbage:
    """Excludes what lives as long as the process from collection, and collects the rest when the loop allows it."""

    def __enter__(self) -> "Garbage":
        gc.collect()
        gc.freeze()
        gc.disable()
        return self

    def __exit__(self, *_: object) -> None:
        gc.enable()
        gc.unfreeze()

    def collect(self, holding: bool) -> None:
        """Collects everything if the arm holds, else the youngest objects if they are too many."""
        young, older, _ = gc.get_count()
        if holding and (young > WORTH or older > 0):
            gc.collect()
        elif young > TOO_MANY:
            gc.collect(0)
