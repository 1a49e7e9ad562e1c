"""Files of people, as plain values: strict YAML and JSON."""

import json
import re
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.decoding.decoding import Unreadable, decode_once
from hyperbit.controller.host.files import MOST, read_file

if TYPE_CHECKING:
    import yaml

MOST_YAML = 4_000_000  # bytes of a YAML file; PyYAML takes 7 s and 170 MB for each million
TOO_DEEP = "its values are nested hundreds of levels deep: is it the right file?"
OCTAL = re.compile(r"0[0-9]")


@cache
def build_loader() -> type["yaml.SafeLoader"]:
    """Returns the class that reads YAML; yaml is imported here, so that `hyperbit stop` need not wait for it."""
    import yaml

    class Loader(yaml.SafeLoader):
        """Safe YAML without aliases and without duplicate keys; PyYAML would silently keep the last of these."""

        def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
            """Returns the next node."""
            if self.check_event(yaml.AliasEvent):  # a few lines of aliases can stand for more than any memory holds
                event = self.peek_event()  # type: ignore[no-untyped-call]
                problem = f"alias *{event.anchor}: write its value out instead"
                raise yaml.composer.ComposerError(None, None, problem, event.start_mark)
            return super().compose_node(parent, index)

        def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
            """Returns the mapping of a node."""
            seen: set[str] = set()
            for key, _ in node.value:
                if str(key.value) in seen:
                    raise yaml.constructor.ConstructorError(None, None, f"{key.value!r} occurs twice", key.start_mark)
                seen.add(str(key.value))
            return super().construct_mapping(node, deep)

        def construct_plain_number(self, node: yaml.ScalarNode) -> float:
            """Returns the number of a node; YAML 1.1 reads 010 as 8, 1:30 as 90 and 1_2 as 12."""
            text = node.value.lstrip("+-")
            number = super().construct_yaml_int if node.tag.endswith(":int") else super().construct_yaml_float
            if "_" in text or ":" in text or OCTAL.match(text):
                words = f"{node.value} is {number(node):g} in YAML: write the number without 0 before it, : and _"
                raise yaml.constructor.ConstructorError(None, None, words, node.start_mark)
            found: float = number(node)
            return found

    for kind in ("int", "float"):
        Loader.add_constructor(f"tag:yaml.org,2002:{kind}", Loader.construct_plain_number)
    return Loader


def read_yaml(path: Path) -> Any:
    """Returns the plain value of a YAML file.

    Raises:
        InputFaults: the file is missing, unreadable, empty or not YAML.
    """
    text = read_text(path, MOST_YAML)
    if not text.strip("\0 \t\r\n"):
        raise InputFaults(path, ["is empty, as a failure of the power can leave it: write it again"])
    return parse_yaml(text, path)


def read_text(path: Path, most: int = MOST) -> str:
    """Returns the text of a file of at most `most` bytes.

    Raises:
        InputFaults: the file is missing, unreadable or too large.
    """
    try:
        return read_file(path, most).decode("utf-8-sig")  # Windows' editors write a byte order mark
    except FileNotFoundError:
        raise InputFaults(path, ["no such file"]) from None
    except UnicodeDecodeError as error:
        raise InputFaults(path, [f"cannot be read: {error}; save it as UTF-8"]) from None
    except (OSError, ValueError) as error:
        raise InputFaults(path, [f"cannot be read: {getattr(error, 'strerror', None) or error}"]) from None


def parse_payload(text: str, path: Path, what: str, field: str, most_yaml: int = MOST_YAML) -> dict[str, Any]:
    """Returns the payload in a text that is JSON or YAML. YAML 1.1 refuses tabs, and reads 1e-05 as text.

    Args:
        text: the text.
        path: of its file, for messages; the text of a file `.json` must be JSON.
        what: kind of the payload, for messages.
        field: its main field, for messages.
        most_yaml: most characters of YAML, which takes a thousand times as long to parse as JSON.

    Raises:
        InputFaults: the text is neither, or no payload.
    """
    try:
        value = decode_once(text)
    except Unreadable as error:
        if error.deep:
            raise InputFaults(path, [TOO_DEEP]) from None
        if path.suffix.lower() == ".json":
            raise InputFaults(path, [f"is not JSON: {error}"]) from None
        if len(text) > most_yaml:
            words = f"the text is no JSON ({error}), and YAML may have {most_yaml} characters at most"
            raise InputFaults(path, [words]) from None
        value = parse_yaml(text, path)
    if not isinstance(value, dict):
        raise InputFaults(path, [f"no {what}: a mapping with `{field}` is needed"])
    try:
        json.dumps(value, allow_nan=False, ensure_ascii=False).encode()
    except RecursionError:
        raise InputFaults(path, [TOO_DEEP]) from None
    except (TypeError, ValueError) as error:
        raise InputFaults(path, [f"no {what}: {error}"]) from None
    return value


def parse_yaml(text: str, path: Path) -> Any:
    """Returns the plain value of a YAML text; faults name `path`.

    Raises:
        InputFaults: the text is not YAML.
    """
    import yaml

    try:
        return yaml.load(text, build_loader())
    except RecursionError:
        raise InputFaults(path, [TOO_DEEP]) from None
    except (yaml.YAMLError, ValueError, OverflowError) as error:
        mark = getattr(error, "problem_mark", None)
        line = None if mark is None else mark.line + 1
        raise InputFaults(path, [f"is not YAML: {' '.join(str(error).split())}"], [line]) from None
    except (LookupError, AttributeError, TypeError):  # PyYAML's constructors of tagged values, as of `!!bool maybe`
        raise InputFaults(path, ["is not YAML: a value does not suit its !!tag"]) from None
