"""Modules in one line of text, such as "prismatic strokes=25,50 link=60", as entries of an arm's file.

Lengths are in the unit of the file, angles in degrees. A number may carry its unit, as in the file.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from hyperbit.controller.armfile.choices import LARGEST, LENGTH, MOST_DEGREES, nearest, number
from hyperbit.controller.armfile.units import MILLIMETRES, factors, value_in

TURNS = {"deg": 1.0, "°": 1.0, "rad": 180.0 / math.pi}


class Number(NamedTuple):
    """A number, or several, of a module."""

    ask: str  # words of the question
    most: int = 1  # numbers that it may have
    fewest: int = 1
    angle: bool = False  # in degrees
    default: str = ""  # in millimetres or degrees; "" if there is none


class Kind(NamedTuple):
    words: str
    numbers: Mapping[str, Number]


LINK = Number("length of the link behind it", default="50")
KINDS: Mapping[str, Kind] = {
    "prismatic": Kind(
        "slide, moved by cylinders in series",
        {"strokes": Number("stroke of each cylinder", most=12, default="50"), "link": LINK},
    ),
    "revolute": Kind(
        "joint that turns to one of its angles",
        {"angles": Number("angles", most=4096, fewest=2, angle=True, default="-30,30"), "link": LINK},
    ),
    "vgt": Kind(
        "truss with three actuators",
        {
            "width": Number("width of base and top", default="200"),
            "lengths": Number("length of an actuator contracted, extended", most=2, fewest=2, default="200,250"),
        },
    ),
    "stewart": Kind(
        "platform on six legs, in space",
        {
            "radii": Number("radius of the lower joints, of the upper joints", most=2, fewest=2, default="150,150"),
            "lengths": Number("length of a leg contracted, extended", most=2, fewest=2, default="180,220"),
        },
    ),
}
LOWER, UPPER = (350, 10, 110, 130, 230, 250), (310, 50, 70, 170, 190, 290)  # [degrees] of the joints of a platform


def parse_module(text: str, unit: str) -> dict[str, Any]:
    """Returns kind, `count` and numbers of a module's text; "prismatic" alone has the defaults.

    Raises ValueError: what was given, and what would be right.
    """
    name, *words = text.split()
    kind = known(name, KINDS, "kind of module")
    given = dict(word.partition("=")[::2] for word in words if "=" in word)
    if odd := [word for word in words if "=" not in word]:
        raise ValueError(f"{odd[0]!r}: a field and its value are needed, such as {next(iter(kind.numbers))}=...")
    values: dict[str, Any] = {"kind": name, "count": 1}
    for field, value in given.items():
        known(field, [*kind.numbers, "count"], f"field of {name}")
        if field == "count":
            values["count"] = whole(value, 1, 10_000)
    for field, own in kind.numbers.items():
        value = given.get(field, default_text(own, unit))
        values[field] = numbers(value, own, field, unit)
        if field not in ("link", "angles") and min(values[field]) <= 0:
            raise ValueError(f"{field}={value}: lengths above 0 are needed")
        if field == "lengths" and values[field][0] >= values[field][1]:
            raise ValueError(f"{field}={value}: contracted and then extended are needed, the second longer")
        if field == "angles" and len(set(values[field])) < len(values[field]):
            raise ValueError(f"{field}={value}: an angle occurs twice")
    return values


def known(name: str, names: Sequence[str] | Mapping[str, Any], what: str) -> Any:
    """Returns the entry of a name, if `names` is a mapping. Raises ValueError if there is none."""
    if name not in names:
        like = nearest(name, names)
        hint = f"did you mean {like!r}? Known" if like else "known"
        raise ValueError(f"{name!r} is no {what}; {hint} are {', '.join(names)}")
    return names[name] if isinstance(names, Mapping) else name


def default_text(own: Number, unit: str) -> str:
    """Returns the default of a number in the unit of the file, as a user would write it."""
    if own.angle or not own.default:
        return own.default
    return ",".join(f"{float(part) / MILLIMETRES[unit]:.4g}" for part in own.default.split(","))


def numbers(text: str, own: Number, field: str, unit: str) -> list[float]:
    """Returns the numbers of a field. Raises ValueError if they are none, or of another number."""
    known_units, most = (TURNS, MOST_DEGREES) if own.angle else (factors(unit)[LENGTH], LARGEST)
    found = []
    for part in text.split(","):
        value = value_in(part, known_units)
        try:
            found.append(number(part, most) if value is None else number(f"{value:.15g}", most))
        except ValueError:
            needed = "an angle in degrees, as 30 or 0.5rad," if own.angle else f"a length in {unit}, as 20 or 2cm,"
            raise ValueError(f"{field}: {needed} is needed, got {part!r}") from None
    if not own.fewest <= len(found) <= own.most:
        several = f"{own.fewest} to {own.most}" if own.most > own.fewest else f"{own.fewest}"
        raise ValueError(f"{field}={text}: {len(found)} numbers, needed are {several}, separated by commas")
    return found


def whole(text: str, least: int, most: int) -> int:
    """Returns a whole number. Raises ValueError if the text is none, or it is out of its bounds."""
    if not text.strip().isdecimal() or len(text) > 9 or not least <= int(text) <= most:
        raise ValueError(f"a whole number from {least} to {most} is needed, got {text!r}")
    return int(text)


def module_line(values: Mapping[str, Any], *, spatial: bool) -> str:
    """Returns the entry of the file for a parsed module, as one line of YAML."""
    count = f", count: {values['count']}" if values["count"] > 1 else ""
    along = "[0, 0, 1]" if spatial else "[0, 1]"
    match values["kind"]:
        case "prismatic":
            link = f"link: {{position: {along_link(values['link'][0], spatial=spatial)}}}"
            cylinders = ", ".join(f"[0, {it:.10g}]" for it in values["strokes"])
            return f"{{type: prismatic, axis: {along}, cylinders: [{cylinders}], {link}{count}}}"
        case "revolute":
            link = f"link: {{position: {along_link(values['link'][0], spatial=spatial)}}}"
            angles = ", ".join(f"{it:.10g} deg" for it in values["angles"])
            axis = "axis: [1, 0, 0], " if spatial else ""
            return f"{{type: revolute, {axis}angles: [{angles}], {link}{count}}}"
        case "vgt":
            return f"{{type: vgt, width: {values['width'][0]:.10g}, lengths: {listed(values['lengths'])}{count}}}"
        case _:
            rings = (joints(values["radii"][k], degrees) for k, degrees in enumerate((LOWER, UPPER)))
            base, top = (", ".join(map(listed, ring)) for ring in rings)
            return f"{{type: platform, base: [{base}], top: [{top}], lengths: {listed(values['lengths'])}{count}}}"


def along_link(length: float, *, spatial: bool) -> str:
    return listed([0.0, 0.0, length] if spatial else [0.0, length])


def joints(radius: float, degrees: Sequence[int]) -> list[list[float]]:
    """Returns joints on a circle in the plane z = 0, with four digits of the radius."""
    digits = 3 - math.floor(math.log10(radius))
    turns = map(math.radians, degrees)
    return [[round(radius * math.cos(it), digits), round(radius * math.sin(it), digits), 0.0] for it in turns]


def listed(values: Sequence[float]) -> str:
    return f"[{', '.join(f'{it:.10g}' for it in values)}]"
