"""A study from its first design to the arms that are judged again by long searches."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import closing
from typing import TYPE_CHECKING, NamedTuple

from hyperbit.controller.design.front import chosen, losses, meets, reference_of, volume
from hyperbit.controller.design.judging import DesignJob, Share
from hyperbit.controller.design.kept import Kept
from hyperbit.controller.design.merit import Judged
from hyperbit.controller.design.search import BATCH, Evaluation, Figures, evaluations
from hyperbit.controller.design.study import Study
from hyperbit.controller.design.template import Values
from hyperbit.controller.studies.stream import results

if TYPE_CHECKING:
    from distributed import Client


class Progress(NamedTuple):
    """How far a study is: `done` of `total` arms of a part, and what its designs are worth together by now."""

    part: str
    done: int
    total: int
    hypervolume: float | None = None


class Finalist(NamedTuple):
    """A design of the front, or an arm for comparison.

    Attributes:
        name: of the arm.
        values: of its parameters; None for comparison.
        arm: the arm.
        first: its figures in the search; None for comparison.
        final: its figures by long searches; None if the study was interrupted before.
    """

    name: str
    values: Values | None
    arm: Judged
    first: Figures | None
    final: Figures | None

    @property
    def figures(self) -> Figures:
        """The final figures, or those of the search."""
        return self.final or self.first or {}


def explore(study: Study, count: int, seed: int, results_so_far: Kept, client: Client | None) -> Iterator[Progress]:
    """Judges designs, then those of the front and the arms for comparison again; yields how far it is.

    Raises:
        StudyFailed: see evaluations, Kept and results.
    """
    job = DesignJob(study)

    def judge(shares: Iterable[Share]) -> Iterator[Figures]:
        with closing(results(job, shares, client)) as stream:
            for found in stream:
                yield from found

    def first(batch: Sequence[Values]) -> Iterator[Figures]:
        return judge([Share(values) for values in batch])

    for one in evaluations(study, count, seed, tuple(results_so_far.designs), first):
        results_so_far.add(one)
        yield Progress("designs", one.design, count, hypervolume(study, results_so_far.designs))
    finals = list(final_shares(study, results_so_far.designs))
    left = [k for k, (name, _) in enumerate(finals) if results_so_far.final(k, name) is None]
    for k, figures in zip(left, judge([finals[k][1] for k in left]), strict=True):
        results_so_far.add_final(finals[k][0], figures)
        yield Progress("judged again", k + 1, len(finals))


def hypervolume(study: Study, designs: Sequence[Evaluation]) -> float | None:
    """Returns the volume that the designs dominate below the worst of the first batch; None before its end."""
    if len(designs) < BATCH:
        return None
    own = [one.figures for one in designs if meets(study.settings, one.figures)]
    reference = reference_of(losses(study.settings, [one.figures for one in designs[:BATCH]]))
    return volume(losses(study.settings, own), reference)


def front(study: Study, designs: Sequence[Evaluation]) -> list[Evaluation]:
    """Returns the designs of the front that meet the study's requirements, at most as many as it judges again."""
    own = [one for one in designs if meets(study.settings, one.figures)]
    if not own:
        return []
    rows = chosen(losses(study.settings, [one.figures for one in own]), study.settings.finalists.most)
    return sorted((own[row] for row in rows), key=lambda one: (one.figures["actuators"], one.design))


def final_shares(study: Study, designs: Sequence[Evaluation]) -> Iterator[tuple[int | str, Share]]:
    """Yields number or name, and share, of each arm that is judged again."""
    for one in front(study, designs):
        yield one.design, Share(one.values, final=True)
    for k, other in enumerate(study.compared):
        yield other.name, Share(None, k, final=True)


def finalists(study: Study, found: Kept) -> list[Finalist]:
    """Returns the designs of the front, fewest actuators first, and the arms for comparison."""
    own, result = front(study, found.designs), list[Finalist]()
    for k, one in enumerate(own):
        name = f"{study.settings.name}-{k + 1:02d}"
        result.append(Finalist(name, one.values, study.build(one.values), one.figures, found.final(k, one.design)))
    for k, other in enumerate(study.compared, len(own)):
        result.append(Finalist(other.name, None, other.arm, None, found.final(k, other.name)))
    return result
