"""Results of `plan`: as lines of JSON, in a table, or as lines of text if there are many."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

from hyperbit.controller.arm.arm import Arm
from hyperbit.controller.commands.common import console, print_json, print_table, results_table, shown
from hyperbit.controller.commands.goal_rows import Orientation
from hyperbit.controller.commands.study.plan_goals import PlanOptions
from hyperbit.controller.commands.study.plan_search import PointSolution
from hyperbit.controller.motion.plans.description import describe_solution

MOST_ROWS = 300  # of a table, which is printed at the end


class ShownResult(NamedTuple):
    """The solution of one point, as it is printed.

    Attributes:
        line: for JSON.
        cells: of the table.
        whole: switches, cost and certificate of the whole trajectory; None: a separate search.
    """

    line: dict[str, Any]
    cells: list[str]
    whole: dict[str, Any] | None


def shown_result(arm: Arm, options: PlanOptions, point: PointSolution) -> ShownResult:
    """Returns a solution as it is printed."""
    line = as_line(arm, options, point)
    return ShownResult(line, cells(point, line), point.whole)


def print_results(found: Iterable[ShownResult], options: PlanOptions, *, as_json: bool, many: bool = False) -> None:
    """Prints each result as a line of JSON, or all in a table.

    Args:
        found: the results.
        options: of the command.
        as_json: print JSON.
        many: print lines of text as the results come, instead of a table at the end.
    """
    work = "effort" if options.effort is not None else "ms"
    columns = "goal", "configuration", "position", r"θ \[rad]", "error", "switches", work
    table, wholes = results_table(*columns), list[dict[str, Any]]()
    if many and not as_json:
        console.print("  ".join(columns))
    for result in found:
        if as_json:
            print_json(result.line)
            continue
        if wholes and result.whole is not wholes[-1] and many:
            console.print(sentence(wholes.pop()))
        if result.whole is not None and not (wholes and result.whole is wholes[-1]):
            wholes.append(result.whole)
        if many:
            console.print("  ".join(cell or "-" for cell in result.cells))
        else:
            table.add_row(*result.cells)
    if not as_json and not many:
        print_table(table)
    for whole in wholes:
        console.print(sentence(whole))


def as_line(arm: Arm, options: PlanOptions, point: PointSolution) -> dict[str, Any]:
    """Returns a solution for JSON."""
    line = {
        "goal": point.position,
        **describe_solution(arm.manipulator, arm.reduced, point.solution, point.orientation is not None),
        "within_tolerance": point.solution.within_tolerance,
    }
    if options.path_tolerance is not None:
        line["between"] = point.between
    if options.goals is not None and not options.apart:
        line["trajectory"] = point.whole
    return line


def cells(point: PointSolution, line: dict[str, Any]) -> list[str]:
    """Returns a solution as cells of the table."""
    found, goal = point.solution, [*point.position, *numbers(point.orientation)]
    angle = "" if point.orientation is None else f", {found.angle:.3f}"
    return [
        ("  " if point.between else "") + ", ".join(f"{x:g}" for x in goal),
        line["configuration"],
        shown(line["position"]),
        shown(line["orientation"]),
        f"[{'green' if found.within_tolerance else 'red'}]{found.error:.5f}{angle}",
        str(found.switches),
        f"{found.seconds * 1e3 if found.effort is None else found.effort:.2f}",
    ]


def numbers(orientation: Orientation) -> list[float]:
    """Returns the numbers of an orientation: none, the angle, or the quaternion."""
    return [] if orientation is None else orientation if isinstance(orientation, list) else [orientation]


def sentence(whole: dict[str, Any]) -> str:
    """Returns a sentence on switches and certificate of a whole trajectory."""
    least = f"at least {whole['lower_bound'] or 0:g}"
    if whole["cost"] == whole["switches"]:
        cost, proven = "", {"optimal": "proven to be the fewest", "bound": f"proven: {least}"}
    else:
        cost = f" of cost {whole['cost']:.6g}"
        proven = {"optimal": "proven to cost least", "bound": f"proven: a cost of {least}"}
    return f"{whole['switches']} switches{cost} in all; {proven.get(whole['certificate'], 'nothing is proven')}"
