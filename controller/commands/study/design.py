"""The command `design`: searches arms for targets, and writes the best as arm files."""

from __future__ import annotations

from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands.arguments import AsJson, Dask, Workers
from hyperbit.controller.commands.common import (
    CommandFailed,
    check_picture,
    console,
    drawing,
    errors,
    print_json,
    print_table,
    results_table,
)
from hyperbit.controller.commands.sharing import checked_sharing, open_workers, progress_bar
from hyperbit.controller.studies.shares import StudyFailed

if TYPE_CHECKING:
    from hyperbit.controller.design.explore import Finalist
    from hyperbit.controller.design.kept import Kept
    from hyperbit.controller.design.study import Study

SEED = "Seed of the search; the targets are drawn with the study's seed. Default: the study's."
INTERRUPTED = "interrupted; the same command with --output goes on where it ended"


def design(
    file: Annotated[Path, typer.Argument(metavar="STUDY.yaml", help="The study's file.", show_default=False)],
    evaluations: Annotated[
        int | None, typer.Option(min=1, max=100_000, help="Number of designs. Default: the study's.")
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, max=2**32 - 1, help=SEED)] = None,
    output: Annotated[
        Path | None, typer.Option(metavar="FILE.jsonl", help="File of all designs, to go on with later.")
    ] = None,
    picture: Annotated[Path | None, typer.Option(help="File for a picture of the designs.")] = None,
    arms: Annotated[Path | None, typer.Option(metavar="FOLDER", help="Folder for the arm files of the best.")] = None,
    workers: Workers = 1,
    dask: Dask = None,
    as_json: AsJson = False,
) -> None:
    """Search arms that reach targets with few switches and few actuators; print the best, write their files.

    `--workers` and `--dask` share the designs. The results stay the same.
    """
    from hyperbit.controller.design.explore import explore, finalists
    from hyperbit.controller.design.kept import kept
    from hyperbit.controller.design.study import read_study

    sharing = checked_sharing(workers, dask)
    study = read_study(file)
    if picture is not None:
        check_picture(picture)
    for warning in study.warnings():
        errors.print(f"{file}: warning: {warning}", markup=False)
    count = evaluations or study.settings.evaluations
    own_seed = study.settings.seed if seed is None else seed
    try:
        with ExitStack() as opened:
            found = opened.enter_context(kept(output, study, own_seed, count))
            client = opened.enter_context(open_workers(sharing, lambda: told(found, output)))
            steps = explore(study, count, own_seed, found, client)
            interrupted = not follow(steps, len(found.designs), shown=not as_json)
    except StudyFailed as error:
        raise CommandFailed(str(error)) from None
    best = finalists(study, found)
    report(study, found, best, arms, as_json=as_json)
    if picture is not None:
        draw(study, found, best, picture)
    if interrupted:
        errors.print(INTERRUPTED)
        raise typer.Exit(130)


def follow(progress: Any, before: int, *, shown: bool) -> bool:
    """Shows how far a study is, until its end; returns False if Ctrl-C ends it before."""
    with closing(progress) as steps, progress_bar("arms", shown=shown) as bar:
        tasks = dict[str, Any]()
        try:
            for step in steps:
                if step.part not in tasks:
                    tasks[step.part] = bar.add_task(step.part, total=step.total, before=before)
                worth = "" if step.hypervolume is None else f", hypervolume {step.hypervolume:.4g}"
                bar.update(tasks[step.part], completed=step.done, description=f"{step.part}{worth}")
        except KeyboardInterrupt:
            return False
    return True


def told(found: Kept, output: Path | None) -> str:
    """Returns what is done so far, for a study that cannot go on."""
    if output is None:
        return ""
    return f"{len(found.designs)} designs are in {output}; the same command goes on with them"


def report(study: Study, found: Kept, best: list[Finalist], arms: Path | None, *, as_json: bool) -> None:
    """Prints the best arms, and writes their files."""
    from hyperbit.controller.design.report import notes, save, table

    written = list[str]()
    if arms is not None:
        try:
            written = [str(path) for path in save(study, best, arms)]
        except OSError as error:
            raise InputFaults(arms, [f"cannot be written: {error.strerror}"]) from None
    impossible = sum(one.impossible for one in found.designs)
    if as_json:
        rows = [{"arm": one.name, "values": one.values, "first": one.first, "final": one.final} for one in best]
        print_json(
            {"study": study.settings.name, "designs": len(found.designs), "impossible": impossible, "arms": rows}
            | {"files": written}
        )
        return
    columns, rows_of_text = table(study, best)
    printed = results_table(*columns)
    for row in rows_of_text:
        printed.add_row(*row)
    console.print(f"{study.settings.name}: {len(found.designs)} designs; {impossible} more draws were no arms")
    print_table(printed)
    for sentence in notes(study, best):
        console.print(sentence)
    for path in written:
        console.print(f"written: {path}")


def draw(study: Study, found: Kept, best: list[Finalist], picture: Path) -> None:
    from hyperbit.controller.design.report import picture_of

    with drawing(picture):
        picture_of(study, found.designs, best).savefig(picture, dpi=110)
    console.print(f"picture: {picture}")
