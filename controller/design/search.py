"""The search for designs: tree-structured Parzen estimators of optuna, in batches that several workers can share.

A batch is drawn before any of its designs is judged, so it does not depend on who judges them, and when. The optimiser
starts from its seed. Known figures in place of new ones bring it to the same state: a study is resumed by replay.
"""

import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from importlib import metadata
from typing import TYPE_CHECKING, Any, NamedTuple

from hyperbit.controller.design.front import GREATER, lacking
from hyperbit.controller.design.settings import ParameterSettings
from hyperbit.controller.design.study import MOST_IMPOSSIBLE, Impossible, Study, all_impossible, rounded
from hyperbit.controller.design.template import Value, Values
from hyperbit.controller.studies.shares import StudyFailed

if TYPE_CHECKING:
    from optuna.trial import Trial

BATCH = 8
RANDOM = 20  # designs before the estimators begin
CANDIDATES = 2  # of which the estimators choose one; of many they choose what they know already
INSTALL = "optuna is not installed: pip install 'hyperbit[design]'"

Figures = dict[str, int | float]
Judge = Callable[[Sequence[Values]], Iterable[Figures]]  # yields the figures of designs, in order


class Evaluation(NamedTuple):
    """A design and its figures. `impossible`: number of designs before it that were impossible, and drawn again."""

    design: int
    values: Values
    figures: Figures
    impossible: int


class Draw(NamedTuple):
    trial: "Trial"
    values: Values
    impossible: int


def optuna_version() -> str:
    """Returns the version of optuna.

    Raises:
        StudyFailed: it is not installed.
    """
    try:
        return metadata.version("optuna")
    except metadata.PackageNotFoundError:
        raise StudyFailed(INSTALL) from None


@contextmanager
def quiet() -> Iterator[Any]:
    """Yields optuna, without its warnings about experimental features and its log of each design."""
    import optuna

    level = optuna.logging.get_verbosity()
    optuna.logging.set_verbosity(optuna.logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield optuna
    finally:
        optuna.logging.set_verbosity(level)


def evaluations(study: Study, count: int, seed: int, known: Sequence[Evaluation], judge: Judge) -> Iterator[Evaluation]:
    """Yields designs with their figures, those that are known first.

    Args:
        study: the study.
        count: number of designs.
        seed: of the optimiser.
        known: the first designs of an earlier run.
        judge: computes the figures of a batch.

    Raises:
        StudyFailed: optuna is missing, designs are impossible all the time, or the known ones are of another search.
    """
    optuna_version()
    with quiet() as optuna:
        sampler = optuna.samplers.TPESampler(
            n_startup_trials=RANDOM, n_ei_candidates=CANDIDATES, multivariate=True, constant_liar=False, seed=seed
        )
        better = ["maximize" if name in GREATER else "minimize" for name in study.settings.objectives]
        search = optuna.create_study(directions=better, sampler=sampler)
    for first in range(0, count, BATCH):
        last = min(first + BATCH, count)
        with quiet():
            draws = [draw(study, search, known[k] if k < len(known) else None) for k in range(first, last)]
        old = [known[k].figures for k in range(first, min(last, len(known)))]
        new = judge([each.values for each in draws[len(old) :]]) if len(old) < len(draws) else ()
        for k, (each, figures) in enumerate(zip(draws, chained(old, new), strict=True), first + 1):
            with quiet():
                for name, lack in lacking(study.settings, figures).items():
                    each.trial.set_constraint(name, lack)
                search.tell(each.trial, [figures[name] for name in study.settings.objectives])
            yield Evaluation(k, each.values, figures, each.impossible)


def chained(old: Sequence[Figures], new: Iterable[Figures]) -> Iterator[Figures]:
    yield from old
    yield from new


def draw(study: Study, search: Any, known: Evaluation | None) -> Draw:
    """Returns the optimiser's next design that is possible; of a known one nothing is built.

    Raises:
        StudyFailed: see evaluations.
    """
    from optuna.trial import TrialState

    faults = list[str]()
    for impossible in range(MOST_IMPOSSIBLE):
        trial = search.ask()
        values = {name: suggested(trial, name, own) for name, own in study.settings.parameters.items()}
        if known is not None:
            possible = impossible == known.impossible
        else:
            try:
                study.build(values)
                possible = True
            except Impossible as error:
                faults.append(str(error))
                possible = False
        if possible and known is not None and dict(known.values) != values:
            raise StudyFailed(f"design {known.design} of the file is of another search: give the name of a new file")
        if possible:
            return Draw(trial, values, impossible)
        search.tell(trial, state=TrialState.FAIL)
    raise StudyFailed(all_impossible(faults))


def suggested(trial: "Trial", name: str, own: ParameterSettings) -> Value:
    """Returns the optimiser's value of a parameter."""
    if own.among is not None:
        return own.among[trial.suggest_categorical(name, list(range(len(own.among))))]
    low, high = own.between or (0, 0)
    if own.whole:
        step = int(own.step or 1)
        return int(trial.suggest_int(name, int(low), int(high) - int(high - low) % step, step=step))
    if own.step is None:
        return rounded(trial.suggest_float(name, low, high))
    steps = int((high - low) / own.step + 1e-9)
    return rounded(low + own.step * int(trial.suggest_int(name, 0, steps)))
