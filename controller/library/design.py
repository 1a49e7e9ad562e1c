"""Which arm to build: the merit of an arm for targets, and studies that search arms."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
from msgspec import to_builtins
from numpy.typing import NDArray

from hyperbit.controller.armfile.strict import InputFaults, check, fault_list
from hyperbit.controller.design import report
from hyperbit.controller.design.explore import Finalist, explore, finalists
from hyperbit.controller.design.judging import judge
from hyperbit.controller.design.kept import kept
from hyperbit.controller.design.merit import Effort, Judged, Merit, Target
from hyperbit.controller.design.search import Evaluation, Figures
from hyperbit.controller.design.settings import StudySettings, faults_of
from hyperbit.controller.design.study import Impossible, digest_of, opened, read_study
from hyperbit.controller.design.study import Study as Searched
from hyperbit.controller.design.template import Value, Values
from hyperbit.controller.library.arguments import Count, Number, Numbers, Seed, plain, typed
from hyperbit.controller.library.arm import Arm
from hyperbit.controller.library.errors import ArmError, GoalError, StudyError
from hyperbit.controller.library.goals import Goal, GoalLike, Goals, all_with_tolerances
from hyperbit.controller.library.obstacles import Obstacle, build_obstacles
from hyperbit.controller.library.plot import require_matplotlib
from hyperbit.controller.studies.shares import StudyFailed
from hyperbit.controller.studies.workers import check_workers, local_workers

if TYPE_CHECKING:
    from distributed import Client
    from matplotlib.figure import Figure


Entries: TypeAlias = "Sequence[GoalLike | Mapping[str, Any]] | NDArray[Any]"


@typed(GoalError)
def merit(
    arm: Arm,
    targets: Goals,
    obstacles: Sequence[Obstacle] = (),
    *,
    weights: Numbers | None = None,
    effort: Number = 20.0,
    missed: Number = 200.0,
    stuck: bool = True,
) -> Merit:
    """Returns what an arm is worth for targets; locked actuators are respected, and the cache is not used.

    Each search starts at the last configuration that reached a target, the first at the arm's home. So it starts, after
    a miss, where the missed search started.

    Args:
        arm: the arm; its own obstacles are respected as well.
        targets: goals, or positions of shape (dimension,).
        obstacles: further obstacles in the world.
        weights: of the targets, positive, shape (n,); None: all 1.
        effort: work of the search for each target, see Solver.solve.
        missed: work for a target that is not reached, see Solver.solve.
        stuck: whether reach with a stuck actuator is computed, which takes most of the time.

    Raises:
        GoalError: there is no target, one has another dimension than the arm, or a number is not positive.
        ObstacleError: an obstacle is invalid, or has another dimension than the arm.
    """
    asked = all_with_tolerances(targets, arm.dimension, arm.tolerance, arm.angle_tolerance, "targets")
    own = np.ones(len(asked)) if weights is None else np.asarray(weights, dtype=float)
    if not asked or own.shape != (len(asked),) or not (np.isfinite(own) & (own > 0)).all():
        raise GoalError("targets: at least one is needed, and weights are positive numbers, one a target")
    for name, value in (("effort", effort), ("missed", missed)):
        if not 0 < value < math.inf:
            raise GoalError(f"{name}: a positive number is needed, got {value!r}")
    goals = [
        Target(one.target, one.tolerance, one.angle_tolerance, float(weight))
        for one, weight in zip(asked, own, strict=True)
    ]
    work, regions = Effort(float(effort), float(missed)), build_obstacles(obstacles, arm.dimension)
    found = judge(judged_arm(arm), goals, work, obstacles=regions, stuck=stuck)
    whole = [
        None if one is None else replace(one, configuration=arm._to_whole(one.configuration)) for one in found.solutions
    ]
    return found._replace(solutions=tuple(whole))


def judged_arm(arm: Arm) -> Judged:
    """Returns an arm in the form in which it is judged."""
    return Judged(arm._arm, arm._reduced, arm._locked_states)


@dataclass(frozen=True)
class BuiltArms:
    """Builds arms by a user's function."""

    function: Callable[..., Arm]

    def __call__(self, values: Values) -> Judged:
        """Returns the arm of some values. Raises Impossible."""
        try:
            arm = self.function(**values)
        except ArmError as error:
            raise Impossible(error.faults[0]) from None
        if not isinstance(arm, Arm):
            raise StudyError(f"build: an Arm is needed, got {arm!r:.80}")
        return judged_arm(arm)


@typed(StudyError)
class Study:
    """Parameters of an arm, and targets for it.

    Args:
        build: called with the parameters by name; returns the arm. An `ArmError` from it means that the values describe
            no arm; others are drawn then. Workers import its module.
        parameters: by name, as in a study's file: `{"between": [4, 8]}`, with a `step` or not, or `{"among": ["BC",
            "AD"]}`. A parameter between whole numbers is whole.
        targets: goals, positions of shape (dimension,), or entries of `targets` of a study's file.
        name: of the study, and of its arms.
        **fields: `objectives`, `require`, `seed`, `evaluations`, `effort` and `finalists` of a study's file.

    Raises:
        StudyError: an argument is wrong, or nearly all values describe no arm.
    """

    def __init__(
        self,
        build: Callable[..., Arm],
        parameters: Mapping[str, Mapping[str, Any]],
        targets: Entries,
        *,
        name: str = "study",
        **fields: Any,
    ) -> None:
        own = {key: dict(value) for key, value in parameters.items()}
        entries = [dict(target) if isinstance(target, Mapping) else entry(target) for target in targets]
        used = {key: f"${key}" for key in own}
        asked = {**fields, "name": name, "parameters": own, "arm": used, "targets": entries}
        given = to_builtins(asked, str_keys=True, enc_hook=plain)
        faults: list[str] = []
        settings = check(given, StudySettings, faults)
        faults += [] if settings is None else faults_of(settings)
        if settings is None or faults:
            raise StudyError(fault_list(name, faults))
        try:
            inspect.signature(build).bind(**dict.fromkeys(parameters))
        except (TypeError, ValueError) as error:
            raise StudyError(f"build: a function of {', '.join(parameters)} is needed: {error}") from None
        try:
            source = inspect.getsource(build)
        except (OSError, TypeError):  # of a session without files, or no plain function
            source = repr(getattr(build, "__qualname__", type(build).__qualname__))
        digest = digest_of([source, {key: value for key, value in given.items() if key != "evaluations"}])
        study, faults = opened(settings, BuiltArms(build), [], digest)
        if study is None:
            raise StudyError(fault_list(name, faults))
        self._searched: Searched = study

    def __repr__(self) -> str:
        """Returns name, parameters and number of targets."""
        own = self._searched
        return f"Study({own.settings.name!r}: {', '.join(own.settings.parameters)}; {len(own.targets)} targets)"


def entry(target: GoalLike) -> dict[str, Any]:
    """Returns a goal as an entry of `targets` of a study's file."""
    goal = target if isinstance(target, Goal) else Goal(target)
    fields = {name: getattr(goal, name) for name in ("position", "orientation", "tolerance", "angle_tolerance")}
    return {name: np.asarray(value).tolist() for name, value in fields.items() if value is not None}


class Design(NamedTuple):
    """An arm that a study has found, or one for comparison.

    Attributes:
        name: of the arm, and of its file.
        values: of the parameters; None: it is for comparison.
        arm: the arm.
        first: figures in the search, by name; None: it is for comparison.
        final: figures by long searches, for new targets if the study has boxes.
    """

    name: str
    values: Mapping[str, Value] | None
    arm: Arm
    first: Figures | None
    final: Figures | None


@dataclass(frozen=True, eq=False)
class Designs:
    """What a study has found.

    Attributes:
        front: designs that no other beats in all objectives, and arms for comparison; fewest actuators first.
        evaluations: each design with its `values` and `figures`, in the order of the search.
        warnings: a sentence for each target beyond the length of the arms.
    """

    front: tuple[Design, ...]
    evaluations: tuple[Evaluation, ...]
    warnings: tuple[str, ...]
    _study: Searched
    _finalists: tuple[Finalist, ...]

    def table(self) -> str:
        """Returns the front as a table, with standard errors for new targets and counts of proofs."""
        columns, rows = report.table(self._study, self._finalists)
        return "\n".join([report.as_text(columns, rows), *report.notes(self._study, self._finalists)])

    def plot(self) -> Figure:
        """Returns a matplotlib figure: actuators against switches, the share of reached targets, and the arms.

        Raises:
            PictureError: matplotlib is not installed.
        """
        require_matplotlib()
        return report.picture_of(self._study, self.evaluations, self._finalists)

    @typed(StudyError)
    def save(self, folder: str | Path) -> list[Path]:
        """Writes the arm's file of each design of the front, and returns the paths.

        An arm without a wiring gets one to boards with 8 outputs.

        Raises:
            ArmError: a file cannot be written.
        """
        try:
            return list(report.save(self._study, self._finalists, Path(folder)))
        except OSError as error:
            raise ArmError([f"cannot be written: {error.strerror}"], str(folder)) from None


@typed(StudyError)
def design(
    study: Study | str | Path,
    evaluations: Count | None = None,
    seed: Seed | None = None,
    output: str | Path | None = None,
    *,
    workers: Count = 1,
    client: Client | None = None,
) -> Designs:
    """Searches the designs of a study, and judges the best again by long searches.

    The result depends on study, number of designs and seed, and not on the workers. A script that starts workers needs
    `if __name__ == "__main__":`, as each worker process imports it.

    Args:
        study: a study, or the path of its file.
        evaluations: number of designs; None: the study's.
        seed: of the search; None: the study's.
        output: file that keeps each design. The same call goes on after them.
        workers: number of processes on this computer; 1: this process.
        client: of a Dask cluster; None: `workers` compute.

    Raises:
        StudyError: the study or its output file is wrong, optuna or Dask is not installed, or the cluster is lost.
    """
    try:
        own = study._searched if isinstance(study, Study) else read_study(Path(study))
        count = own.settings.evaluations if evaluations is None else int(evaluations)
        if client is not None:
            check_workers(client)
        chosen = own.settings.seed if seed is None else int(seed)
        path = None if output is None else Path(output)
        alone = client is not None or workers == 1
        with kept(path, own, chosen, count) as found, nullcontext(client) if alone else local_workers(workers) as used:
            for _ in explore(own, count, chosen, found, used):
                pass
    except (InputFaults, StudyFailed) as error:
        raise StudyError(str(error)) from None
    best = finalists(own, found)
    front = [Design(one.name, one.values, Arm._of(one.arm.arm, one.arm.locked), one.first, one.final) for one in best]
    return Designs(tuple(front), tuple(found.designs), tuple(own.warnings()), own, tuple(best))
