"""The arm of a study: an arm's file in which `$name` stands for a parameter, and its values for one design."""

import math
from collections.abc import Iterator, Mapping
from typing import Any

Value = int | float | str
Values = Mapping[str, Value]


def names_in(template: Any, path: str = "") -> Iterator[tuple[str, str]]:
    """Yields each parameter that a template names, and the path of the place."""
    match template:
        case str() if template.startswith("$"):
            yield template[1:], path
        case dict():
            for name, part in template.items():
                yield from names_in(part, f"{path}.{name}" if path else str(name))
        case list():
            for k, part in enumerate(template):
                yield from names_in(part, f"{path}[{k}]")


def filled(template: Any, values: Values) -> Any:
    """Returns a template with the values of the parameters, and with the results of `sum` and `product`."""
    match template:
        case str() if template.startswith("$"):
            return values[template[1:]]
        case {"sum": [*parts]} | {"product": [*parts]} if len(template) == 1:
            return combined(next(iter(template)), [filled(part, values) for part in parts])
        case dict():
            return {name: filled(part, values) for name, part in template.items()}
        case list():
            return [filled(part, values) for part in template]
    return template


def combined(operator: str, parts: list[Any]) -> Any:
    """Returns the sum or product of numbers; of anything else what was given, so that its place refuses it."""
    if not parts or not all(isinstance(part, int | float) and not isinstance(part, bool) for part in parts):
        return {operator: parts}
    return sum(parts) if operator == "sum" else math.prod(parts)
