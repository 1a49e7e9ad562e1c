"""Lists all mutants of a source file. The id of a mutant has no line number, so it survives other edits of the file."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

from tests.mutants.operators import OPERATORS, Change, Context, is_log, is_text

LONGEST = 90  # characters of a part of an id
SILENT = ("__repr__", "__str__")  # texts for people


@dataclass(frozen=True)
class Mutant:
    """A planted defect.

    Attributes:
        id: file, function, statement and change; with an ordinal if the function has the same one before.
        original: source of the file, UTF-8.
        text: what replaces that part.
    """

    id: str
    file: str
    operator: str
    original: bytes
    begin: int
    end: int
    text: str

    @property
    def module(self) -> str:
        return "hyperbit." + self.file.removesuffix(".py").removesuffix("/__init__").replace("/", ".")

    @property
    def source(self) -> str:
        return (self.original[: self.begin] + self.text.encode() + self.original[self.end :]).decode()

    @property
    def kernel(self) -> bool:
        return "@kernel" in self.source

    @property
    def place(self) -> dict[str, Any]:
        """File, number of the first line that changes, and this line before and after the change."""
        before, after = self.original.decode().splitlines(), self.source.splitlines()
        k = next(k for k, (one, two) in enumerate(zip(before, after, strict=False)) if one != two)
        return {"file": self.file, "line": k + 1, "before": before[k].strip(), "after": after[k].strip()}


def mutants_of(path: str, source: str) -> list[Mutant]:
    return list(_Sites(path, source).all())


class _Sites:
    def __init__(self, path: str, source: str) -> None:
        self._path, self._bytes = path, source.encode()
        self._tree = ast.parse(source)
        self._starts = [0]
        for line in self._bytes.splitlines(keepends=True):
            self._starts.append(self._starts[-1] + len(line))
        self._last = _last_statements(self._tree)
        self._same: Counter[str] = Counter()

    def all(self) -> Iterator[Mutant]:
        yield from self._visit(self._tree, (), Context(), "")

    def _visit(self, node: ast.AST, scope: tuple[str, ...], context: Context, statement: str) -> Iterator[Mutant]:
        if isinstance(node, ast.stmt):
            statement = ast.unparse(node).split("\n")[0].removesuffix(":")
            context = replace(context, last=node in self._last)
        for operator in OPERATORS:
            for change in operator(node, context):
                yield self._mutant(change, scope, statement)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            scope = (*scope, node.name)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            context = Context(function=True, constructor=getattr(node, "name", "") == "__init__")
        for child in visited(node):
            yield from self._visit(child, scope, context, statement)

    def _mutant(self, change: Change, scope: tuple[str, ...], statement: str) -> Mutant:
        old: Any = change.old
        begin = self._starts[old.lineno - 1] + old.col_offset
        end = self._starts[old.end_lineno - 1] + old.end_col_offset
        text = new = change.new if isinstance(change.new, str) else ast.unparse(change.new)
        if change.guard:
            text = f"{self._bytes[begin:end].decode()} {new}"
        elif isinstance(change.new, ast.expr) and not isinstance(change.new, ast.Constant | ast.Name):
            text = f"({new})"
        was = ast.unparse(old)
        places = [self._path, ".".join(scope) or "module", statement, f"{was} => {new}"]
        if was == statement:
            places[2:] = [statement, new]
        name = "::".join(_shortened(place) for place in places)
        self._same[name] += 1
        ordinal = f" #{self._same[name]}" if self._same[name] > 1 else ""
        return Mutant(name + ordinal, self._path, change.operator, self._bytes, begin, end, text)


def visited(node: ast.AST) -> Iterator[ast.AST]:
    """Yields the children of a node that have mutants: no types, texts, logs, messages, or assertions for types."""
    hidden: Iterable[ast.AST | None] = ()
    match node:
        case ast.FunctionDef() | ast.AsyncFunctionDef():
            hidden = [node.returns, *node.decorator_list]
            if node.name in SILENT:
                return
        case ast.arg() | ast.Assert() | ast.Raise() | ast.JoinedStr() | ast.Import() | ast.ImportFrom() | ast.pattern():
            return
        case ast.AnnAssign():
            hidden = [node.annotation]
        case ast.ClassDef():
            hidden = [*node.bases, *node.keywords, *node.decorator_list]
        case ast.If(test=ast.Name(id="TYPE_CHECKING")):
            return
        case ast.Call(func=ast.Name(id="isinstance" | "cast")):
            hidden = node.args[1:] if node.func.id == "isinstance" else node.args[:1]  # type: ignore[attr-defined]
    without = {id(child) for child in hidden}
    for child in ast.iter_child_nodes(node):
        if id(child) not in without and not is_text(child) and not is_log(getattr(child, "value", child)):
            yield child


def _last_statements(tree: ast.AST) -> set[ast.stmt]:
    found: set[ast.stmt] = set()

    def take(body: list[ast.stmt]) -> None:
        if not body:
            return
        found.add(body[-1])
        match body[-1]:
            case ast.If() as last:
                take(last.body)
                take(last.orelse)
            case ast.With() as last:
                take(last.body)
            case ast.Match() as last:
                for case in last.cases:
                    take(case.body)

    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.For | ast.While):
            take(node.body)
    return found


def _shortened(text: str) -> str:
    text = " ".join(text.split())
    if len(text) <= LONGEST:
        return text
    return f"{text[: LONGEST - 12]}...{sha256(text.encode()).hexdigest()[:8]}"


def listed(root: Path, rooms: Iterable[str], room_of: Callable[[str], str]) -> dict[str, list[Mutant]]:
    """Returns the mutants of rooms; `room_of` names the room of a file, as a room may lie in another."""
    return {
        room: [
            mutant
            for path in sorted((root / room).rglob("*.py"))
            if room_of(file := path.relative_to(root).as_posix()) == room
            for mutant in mutants_of(file, path.read_text())
        ]
        for room in rooms
    }


def sample(mutants: dict[str, list[Mutant]], count: int, seed: int) -> list[Mutant]:
    """Draws from each room in proportion to its mutants, in random order; another edit keeps most of the sample."""
    total = sum(map(len, mutants.values()))
    count = min(count, total)
    shares = {room: count * len(of_room) / total for room, of_room in mutants.items() if of_room}
    counts = {room: int(share) for room, share in shares.items()}
    largest = sorted(shares, key=lambda room: counts[room] - shares[room])
    for room in largest[: count - sum(counts.values())]:
        counts[room] += 1

    def drawn(mutant: Mutant) -> bytes:
        return sha256(f"{seed} {mutant.id}".encode()).digest()

    chosen = [mutant for room in counts for mutant in sorted(mutants[room], key=drawn)[: counts[room]]]
    return sorted(chosen, key=drawn)
