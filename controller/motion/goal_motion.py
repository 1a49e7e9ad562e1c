"""How moving goals move, and how streams of set-points behave."""

from dataclasses import dataclass, fields

LEAST, MOST = 1e-9, 1e6  # of a value of Tracking; beyond, its square or another's is lost to rounding


@dataclass(frozen=True)
class Tracking:
    """How goals move and streams behave; lengths in the arm's unit, the defaults in metres.

    Attributes:
        acceleration: standard deviation of the goal's acceleration between two setpoints [m/s^2].
        noise: standard deviation of a setpoint's coordinate [m].
        speed: standard deviation of a coordinate's velocity at the start [m/s]; one four times as fast is not caught.
        timeout: the stream has stopped when it has been quiet for so long [s]; no prediction looks further ahead.
        validity: a setpoint older on arrival is stale [s].
        slack: how far the sender's clock may run ahead of ours [s].
        agreeing: outliers in a row that agree on a new track make it the goal's.
    """

    acceleration: float = 0.5
    noise: float = 0.002
    speed: float = 0.5
    timeout: float = 0.25
    validity: float = 0.2
    slack: float = 0.02
    agreeing: int = 3

    def __post_init__(self) -> None:
        """Raises ValueError where a value is out of bounds, or setpoints are valid for longer than the time-out."""
        for field in fields(self):
            value = getattr(self, field.name)
            if not LEAST <= value <= MOST:
                raise ValueError(f"{field.name}: {value} given, a number from 1e-9 to 1e6 is needed")
        if self.validity + self.slack > self.timeout:  # else, after a time-out, one could be older than the last
            raise ValueError(
                f"validity: {self.validity:g} s and slack {self.slack:g} s exceed timeout {self.timeout:g} s"
            )


def tracking_of(length: float, tolerance: float) -> Tracking:
    """Returns how goals of an arm move, in its own unit of length.

    A set-point is about as exact as the tolerance. A goal passes an eighth of the arm's length in a second, and reaches
    that speed in a second.

    Args:
        length: of the arm.
        tolerance: of its goals.
    """
    speed = min(max(length / 8, LEAST), MOST)
    return Tracking(acceleration=speed, noise=min(max(min(tolerance, length / 100), LEAST), MOST), speed=speed)
