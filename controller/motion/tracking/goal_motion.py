"""Parameters of moving goals and of streams of set-points."""

from dataclasses import dataclass, fields

LEAST, MOST = 1e-9, 1e6  # of a value of Tracking; outside, squares lose all precision


@dataclass(frozen=True)
class Tracking:
    """How goals move and how streams behave; lengths in the arm's unit, defaults in metres."""

    acceleration: float = 0.5  # standard deviation of the goal's acceleration between two set-points [m/s^2]
    noise: float = 0.002  # standard deviation of a set-point's coordinate [m]
    # standard deviation of the initial velocity, per coordinate [m/s]; four times this speed is not tracked
    speed: float = 0.5
    timeout: float = 0.25  # silence after which the stream has stopped [s]; predictions look no further ahead
    validity: float = 0.2  # greatest age of a set-point on arrival [s]
    slack: float = 0.02  # how far the sender's clock may be ahead of ours [s]
    agreeing: int = 3  # consecutive outliers that must agree before they start a new track

    def __post_init__(self) -> None:
        """Raises ValueError if a value is out of bounds, or if validity and slack exceed the time-out."""
        for field in fields(self):
            value = getattr(self, field.name)
            if not LEAST <= value <= MOST:
                raise ValueError(f"{field.name}: {value} given, a number from 1e-9 to 1e6 is needed")
        if self.validity + self.slack > self.timeout:  # otherwise the first set-point after a time-out may be too old
            raise ValueError(
                f"validity: {self.validity:g} s and slack {self.slack:g} s exceed timeout {self.timeout:g} s"
            )


def tracking_of(length: float, tolerance: float) -> Tracking:
    """Returns the parameters of goals for one arm, in its own unit of length.

    The noise of a set-point is about the tolerance. A goal crosses an eighth of the arm's length in one second, and
    reaches that speed in one second.

    Args:
        length: of the arm.
        tolerance: of the position of its goals.
    """
    speed = min(max(length / 8, LEAST), MOST)
    return Tracking(acceleration=speed, noise=min(max(min(tolerance, length / 100), LEAST), MOST), speed=speed)
