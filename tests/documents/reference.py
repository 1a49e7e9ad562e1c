"""Writes the reference page of the library from its docstrings. python -m tests.documents.reference"""

import inspect
from collections.abc import Iterator
from typing import Any

import hyperbit as hb
from tests.documents.page import ROOT

PATH = ROOT / "controller/library/reference.md"
HEAD = """# Reference of the Python library

Each public name of `hyperbit` with the first sentence of its docstring. `help(hb.NAME)` prints arguments with shapes
and units, and the exceptions. The [library's page](README.md) has examples. `python -m tests.documents.reference`
writes this page from the docstrings.
"""


def text() -> str:
    """Returns the text of the page."""
    public = {name: getattr(hb, name) for name in hb.__all__}
    classes = {name: it for name, it in public.items() if inspect.isclass(it)}
    errors = {name: it for name, it in classes.items() if issubclass(it, Exception)}
    lines = [HEAD, "## Functions", ""]
    lines += [row(name, it) for name, it in public.items() if inspect.isfunction(it)]
    for name, it in classes.items():
        if name not in errors:
            rows = list(members(it))
            lines += ["", f"## {name}", "", f"{call(name, it)}: {sentence(it)}", *([""] if rows else []), *rows]
    lines += ["", "## Exceptions", "", *(f"- `{name}`: {sentence(it)}" for name, it in errors.items())]
    return "\n".join(lines) + "\n"


def call(name: str, kind: Any) -> str:
    """Returns how a class is called; of a named tuple, which only functions make, its fields."""
    if issubclass(kind, tuple):
        return f"Tuple of {', '.join(f'`{field}`' for field in kind._fields)}"
    return called(name, kind.__init__)


def members(kind: type) -> Iterator[str]:
    """Yields a row for each public method and property of a class and of its bases, in the order of the source."""
    own = [vars(base) for base in kind.__mro__ if base.__module__.startswith("hyperbit.")]
    for name, member in (pair for each in own for pair in each.items()):
        if name.startswith("_"):
            continue
        if inspect.isfunction(member):
            yield row(name, member)
        elif isinstance(member, property) or hasattr(member, "func"):
            yield f"- `{name}`: {sentence(member)}"


def row(name: str, function: Any) -> str:
    return f"- {called(name, function)}: {sentence(function)}"


def called(name: str, function: Any) -> str:
    """Returns the call of a function or method, with the names of its arguments."""
    parts = list[str]()
    for parameter in inspect.signature(function).parameters.values():
        if parameter.kind is parameter.KEYWORD_ONLY and "*" not in parts:
            parts.append("*")
        if parameter.name != "self" and not parameter.name.startswith("_"):
            parts.append(parameter.name if parameter.default is parameter.empty else f"{parameter.name}=")
    return f"`{name}({', '.join(parts)})`"


def sentence(it: Any) -> str:
    """Returns the first paragraph of a docstring as one line."""
    return " ".join((inspect.getdoc(it) or "").partition("\n\n")[0].split())


if __name__ == "__main__":
    PATH.write_text(text(), encoding="utf-8")
