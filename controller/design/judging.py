"""The figures of one design: what a worker computes."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from hyperbit.controller.design.merit import Effort, Judged, Merit, Target, merit_of, searched, searcher_of
from hyperbit.controller.design.search import Figures
from hyperbit.controller.design.stuck import decide, witnesses
from hyperbit.controller.design.study import Study
from hyperbit.controller.design.template import Values
from hyperbit.controller.obstacles.obstacles import NONE, Obstacles
from hyperbit.controller.studies.shares import Run


class Share(NamedTuple):
    """One arm to judge: a design by its values, or an arm for comparison by its number; `final`: by long searches."""

    values: Values | None
    compared: int = 0
    final: bool = False


class DesignJob(NamedTuple):
    """What all designs of a study have in common."""

    study: Study

    def prepare(self) -> Run:
        """Returns the function that yields the figures of an arm."""
        return self._run

    def _run(self, share: Share) -> Iterator[Figures]:
        study = self.study
        own = study.compared[share.compared].arm if share.values is None else study.build(share.values)
        yield final_figures(study, own) if share.final else first_figures(study, own)


def judge(
    own: Judged,
    targets: Sequence[Target],
    effort: Effort,
    *,
    obstacles: Obstacles = NONE,
    stuck: bool = False,
    exact: bool = True,
) -> Merit:
    """Returns the merit of an arm.

    Args:
        own: the arm.
        targets: at least one.
        effort: work for each.
        obstacles: further obstacles in the world.
        stuck: whether reach with a stuck actuator is computed.
        exact: whether searches with a locked actuator decide what no configuration witnesses.
    """
    searcher = searcher_of(own, obstacles)
    solutions = list(searched(searcher, targets, effort))
    found = merit_of(own, targets, solutions)
    if not stuck:
        return found
    seen = witnesses(searcher, targets, solutions)
    if exact:
        decide(seen, own, obstacles, effort=effort)
    return found._replace(stuck=seen.share)


def first_figures(study: Study, own: Judged) -> Figures:
    """Returns the figures for the optimiser; `stuck` is a lower bound."""
    work = study.settings.effort
    found = judge(own, study.targets, Effort(work.search, work.missed), stuck=study.stuck, exact=False)
    return figures_of(found)


def final_figures(study: Study, own: Judged) -> Figures:
    """Returns the figures by long searches: for fresh targets if there are any, and `stuck` for the study's own."""
    work = study.settings.finalists
    effort, targets = Effort(work.search, work.missed), study.fresh or study.targets
    found = judge(own, targets, effort)
    counts = {"proven": found.proven, "targets": len(targets)}
    errors = {"reached_error": found.reached_error, "switches_error": found.switches_error} if study.fresh else {}
    if study.stuck:
        found = found._replace(stuck=judge(own, study.targets, effort, stuck=True).stuck)
    return {**figures_of(found), **errors, **counts}


def figures_of(found: Merit) -> Figures:
    stuck = {} if found.stuck is None else {"stuck": found.stuck}
    return {"reached": found.reached, "switches": found.switches, **stuck, "actuators": found.actuators} | {
        "length": found.length
    }
