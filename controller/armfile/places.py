"""Places in a YAML file: the line of each fault, and list positions counted from 1."""

import contextlib
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from hyperbit.controller.armfile.documents import MOST_YAML, build_loader, read_text
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.armfile.wiring_table import FIELD, row_faults

if TYPE_CHECKING:
    import yaml

POSITION = re.compile(r"\[(\d{1,9})\]")
END_OF_NAME = ("", ".", "[", ":")  # what may follow the name of a field in a path


class PlacedFault(NamedTuple):
    """A fault whose path counts list positions from 1, and the line of the innermost node of this path, if any."""

    text: str
    line: int | None


def path_text(keys: Sequence[str | int]) -> str:
    """Returns the path of keys and indices from the top of a file, such as modules[0].link.position[1]."""
    return "".join(f"[{key}]" if isinstance(key, int) else f".{key}" for key in keys).removeprefix(".")


@contextlib.contextmanager
def placed_faults(path: Path) -> Iterator[None]:
    """Adds the lines of a YAML file to the faults that are raised in this context.

    Raises:
        InputFaults: as in the context, with lines and with list positions counted from 1.
    """
    try:
        yield
    except InputFaults as error:
        if error.lines:  # placed already
            raise
        placed = place(path, error.faults)
        raise InputFaults(path, [fault.text for fault in placed], [fault.line for fault in placed]) from None


def place(path: Path, faults: Sequence[str]) -> list[PlacedFault]:
    """Returns the faults of a YAML file with their lines; each fault is "path: text", and its path counts from 0."""
    root = compose(path)
    if (name := wiring_name(root)) is not None:
        faults = row_faults(path.parent, name, faults)
    return [find(fault, root) for fault in faults]


def wiring_name(root: "yaml.Node | None") -> str | None:
    """Returns the name of the CSV file that has the wiring; None if the actuators stand in the file itself."""
    import yaml

    entry = named_entry(root, FIELD)
    return entry[1].value if entry is not None and isinstance(entry[1], yaml.ScalarNode) else None


def compose(path: Path) -> "yaml.Node | None":
    """Returns the nodes of a YAML file, which know their lines; None if the file is unreadable or not YAML."""
    import yaml

    try:
        return yaml.compose(read_text(path, MOST_YAML), build_loader())
    except (ValueError, RecursionError, yaml.YAMLError):
        return None


def find(fault: str, root: "yaml.Node | None") -> PlacedFault:
    """Returns a fault with the line of the innermost node that its path names."""
    import yaml

    node, line, done, rest = root, None, "", fault
    while True:
        position = POSITION.match(rest)
        if position is not None:
            number = int(position[1])
            done, rest = f"{done}[{number + 1}]", rest[position.end() :]
            known = isinstance(node, yaml.SequenceNode) and number < len(node.value)
            node = node.value[number] if known and node is not None else None
            line = line if node is None else node.start_mark.line + 1
            continue
        dot = "." if done and rest.startswith(".") else ""
        entry = named_entry(node, rest[len(dot) :]) if dot or not done else None
        if entry is None:
            return PlacedFault(done + counted(rest), line)
        key, node = entry
        end = len(dot) + len(key.value[:80])
        done, rest, line = done + rest[:end], rest[end:], key.start_mark.line + 1


def named_entry(node: "yaml.Node | None", text: str) -> "tuple[yaml.ScalarNode, yaml.Node] | None":
    """Returns key and value of the entry of a mapping whose name begins `text`; of several the longest name."""
    import yaml

    if not isinstance(node, yaml.MappingNode):
        return None
    keys = [(key, value) for key, value in node.value if isinstance(key, yaml.ScalarNode) and begins(key.value, text)]
    return max(keys, key=lambda entry: len(entry[0].value), default=None)


def begins(name: str, text: str) -> bool:
    """Returns whether a path begins with a name; paths have names cut to 80 characters."""
    shown = name[:80]
    return bool(shown) and text.startswith(shown) and text[len(shown) : len(shown) + 1] in END_OF_NAME


def counted(fault: str) -> str:
    """Returns a path, or a path and the fault behind it, with list positions counted from 1 instead of 0."""
    path, colon, text = fault.partition(": ")
    return POSITION.sub(lambda match: f"[{int(match[1]) + 1}]", path) + colon + text
