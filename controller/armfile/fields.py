"""Types of fields of an arm's file: bounds, and the unit in which a number is meant."""

from typing import Annotated, Literal

from msgspec import Meta

from hyperbit.controller.armfile.choices import LARGEST, LARGEST_ANGLE, LENGTH, RADIANS, SECONDS

Positive = Annotated[float, Meta(gt=0, le=LARGEST, description=LENGTH)]
Coordinate = Annotated[float, Meta(ge=-LARGEST, le=LARGEST, description=LENGTH)]
Component = Annotated[float, Meta(ge=-LARGEST, le=LARGEST)]  # of a direction or quaternion, without a unit
Pair = tuple[Positive, Positive]
Count = Annotated[int, Meta(ge=1, le=10_000)]
Bit = Annotated[int, Meta(ge=0, le=2031)]  # of 254 bytes
Node = Annotated[int, Meta(ge=1, le=126)]  # 127 is the master's
Word = Annotated[int, Meta(ge=0, le=0xFFFF_FFFF)]
Travel = Annotated[float, Meta(gt=0, le=60, description=SECONDS)]
Margin = Annotated[float, Meta(ge=0, le=10, description=SECONDS)]
NAME = "1 to 64 letters, digits, _ and -"
Name = Annotated[str, Meta(pattern=r"^[A-Za-z0-9_-]{1,64}\Z", description=NAME)]
Vector = Annotated[list[Coordinate], Meta(min_length=2, max_length=3)]
Direction = Annotated[list[Component], Meta(min_length=2, max_length=3)]
SpatialDirection = Annotated[list[Component], Meta(min_length=3, max_length=3)]
Sides = Annotated[list[Positive], Meta(min_length=2, max_length=3)]
Angle = Annotated[float, Meta(ge=-LARGEST_ANGLE, le=LARGEST_ANGLE, description=RADIANS)]
AngleTolerance = Annotated[float, Meta(ge=1e-9, le=LARGEST_ANGLE, description=RADIANS)]
Quaternion = Annotated[list[Component], Meta(min_length=4, max_length=4)]
Diagonal = Literal["BC", "AD"]  # of a truss module
