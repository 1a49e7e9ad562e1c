"""Mutation operators: each yields small changes of one node of the syntax tree."""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator
from copy import deepcopy
from dataclasses import dataclass

SWAPPED: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.And: ast.Or,
    ast.Or: ast.And,
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
}
NEGATED_BY_SWAP = (ast.Eq, ast.NotEq, ast.In, ast.NotIn, ast.Is, ast.IsNot)
EXTREMES = {"min": "max", "max": "min"}
REMOVED = "pass"
LEVELS = ("debug", "info", "warning", "error", "critical", "exception", "log")  # methods of a logger


@dataclass(frozen=True)
class Context:
    """Where a node is.

    Attributes:
        last: whether nothing runs after this statement in its function, or in its pass of a loop.
    """

    function: bool = False
    constructor: bool = False
    last: bool = False


@dataclass(frozen=True)
class Change:
    """A change of the source text: `new` replaces `old`, which may be a part of the visited node.

    Attributes:
        guard: `old` is a pattern, and `new` its guard.
    """

    operator: str
    old: ast.AST
    new: ast.AST | str
    guard: bool = False


def comparisons(node: ast.AST, context: Context) -> Iterator[Change]:
    if isinstance(node, ast.Compare):
        for k, operator in enumerate(node.ops):
            if type(operator) in SWAPPED:
                new = deepcopy(node)
                new.ops[k] = SWAPPED[type(operator)]()  # type: ignore[call-overload]
                yield Change("comparison", node, new)


def swapped_operators(node: ast.AST, context: Context) -> Iterator[Change]:
    """And/or, +/-, &/|; unions of types stand outside of functions."""
    if not isinstance(node, ast.BoolOp | ast.BinOp | ast.AugAssign) or type(node.op) not in SWAPPED:
        return
    if isinstance(node.op, ast.BitOr) and not context.function:
        return
    if isinstance(node, ast.BinOp) and (is_text(node.left) or is_text(node.right)):
        return
    new = deepcopy(node)
    new.op = SWAPPED[type(node.op)]()  # type: ignore[assignment]
    yield Change("boolean" if isinstance(node, ast.BoolOp) else "arithmetic", node, new)


def negations(node: ast.AST, context: Context) -> Iterator[Change]:
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.Invert):
        yield Change("negation", node, node.operand)


def conditions(node: ast.AST, context: Context) -> Iterator[Change]:
    """Forces and negates conditions, if no other operator does the same."""
    if isinstance(node, ast.comprehension):
        for test in node.ifs:
            yield Change("condition", test, "True")
    if isinstance(node, ast.match_case) and node.guard is not None:
        yield Change("condition", node.guard, "True")
    if not isinstance(node, ast.If | ast.While | ast.IfExp) or isinstance(node.test, ast.Constant):
        return
    test = node.test
    if isinstance(test, ast.Name) and test.id == "TYPE_CHECKING":
        return
    if not isinstance(node, ast.While):
        yield Change("condition", test, "True")
    if not (isinstance(node, ast.If) and not node.orelse and len(node.body) == 1 and removable(node.body[0], context)):
        yield Change("condition", test, "False")
    single = isinstance(test, ast.Compare) and len(test.ops) == 1 and isinstance(test.ops[0], NEGATED_BY_SWAP)
    if not single and not isinstance(test, ast.UnaryOp):
        yield Change("condition", test, ast.UnaryOp(ast.Not(), test))


def constants(node: ast.AST, context: Context) -> Iterator[Change]:
    if isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield Change("constant", node, ast.Constant(not node.value))
    elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        yield Change("constant", node, ast.Constant(node.value + 1))
        if node.value == 1:
            yield Change("constant", node, ast.Constant(type(node.value)(0)))


def returned_values(node: ast.AST, context: Context) -> Iterator[Change]:
    if isinstance(node, ast.Return) and node.value is not None and not isinstance(node.value, ast.Constant):
        yield Change("returned value", node.value, "None")


def removals(node: ast.AST, context: Context) -> Iterator[Change]:
    if isinstance(node, ast.stmt) and removable(node, context):
        yield Change("removal", node, REMOVED)


def removable(node: ast.stmt, context: Context) -> bool:
    """Returns whether to remove a statement: what assigns in a constructor is missed at once, a last one never."""
    match node:
        case ast.Expr(value=ast.Call()):
            return not is_log(node.value)
        case ast.Assign(targets=[ast.Attribute() | ast.Subscript(), *_]):
            return not context.constructor
        case ast.AugAssign() | ast.Delete() | ast.Raise() | ast.Break():
            return True
        case ast.Return() | ast.Continue():
            return not context.last
    return False


def arguments(node: ast.AST, context: Context) -> Iterator[Change]:
    """Swaps neighbours that are both names, or both attributes."""
    if not isinstance(node, ast.Call) or named(node.func) in ("isinstance", "min", "max"):
        return
    for k in range(len(node.args) - 1):
        one, two = node.args[k : k + 2]
        same_kind = type(one) is type(two) and isinstance(one, ast.Name | ast.Attribute)
        if same_kind and ast.dump(one) != ast.dump(two):
            new = deepcopy(node)
            new.args[k : k + 2] = [two, one]
            yield Change("arguments", node, new)


def extremes(node: ast.AST, context: Context) -> Iterator[Change]:
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in EXTREMES:
        yield Change("extreme", node.func, EXTREMES[node.func.id])


def cases(node: ast.AST, context: Context) -> Iterator[Change]:
    if isinstance(node, ast.match_case):
        if node.guard is None:
            yield Change("case", node.pattern, "if False", guard=True)
        else:
            yield Change("case", node.guard, "False")


OPERATORS: tuple[Callable[[ast.AST, Context], Iterator[Change]], ...] = (
    comparisons,
    swapped_operators,
    negations,
    conditions,
    constants,
    returned_values,
    removals,
    arguments,
    extremes,
    cases,
)


def is_text(node: ast.AST) -> bool:
    """Returns whether a node is a string, also an f-string."""
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str | bytes))


def named(node: ast.AST) -> str:
    return node.attr if isinstance(node, ast.Attribute) else getattr(node, "id", "")


def is_log(node: ast.AST) -> bool:
    """Returns whether a call only writes a line of the log."""
    if not isinstance(node, ast.Call):
        return False
    name, owner = named(node.func), named(getattr(node.func, "value", node.func))
    if name in ("Log", "_log") or (owner.lower() == "log" and name in LEVELS):
        return True
    return any(is_log(argument) for argument in node.args)
