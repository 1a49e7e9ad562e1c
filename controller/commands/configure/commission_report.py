"""The end of a commission: what was found, the report, and the proposal for the arm's file."""

from __future__ import annotations

from pathlib import Path

import typer

from hyperbit.controller.armfile.actuators import read_wired
from hyperbit.controller.armfile.documents import MOST_YAML, read_text
from hyperbit.controller.armfile.settings import ArmSettings, TravelSettings
from hyperbit.controller.armfile.strict import InputFaults
from hyperbit.controller.commands.configure.commission_desk import Desk
from hyperbit.controller.commission.diagnosis import Diagnosis
from hyperbit.controller.commission.proposal import diff, proposed_text
from hyperbit.controller.commission.questions import Choice
from hyperbit.controller.commission.session import Session, write_whole
from hyperbit.controller.commission.travels import measured, proposed, written


def conclude(file: Path, settings: ArmSettings, session: Session, desk: Desk) -> None:
    """Tells and writes the report and the proposal, and writes the arm's file if the person wants it."""
    desk.begin("Report")
    found = session.diagnosis
    times = measured(session.entries, found.entries, session.sightings)
    travel, single = proposed(times)
    if travel == present_travel(settings):
        travel = None
    lines = report(session, found, times, single)
    report_path = file.with_name(f"{file.stem}.commission.txt")
    write_whole(report_path, "\n".join([*lines, ""]).encode())
    for line in (*lines, f"report: {report_path}"):
        desk.say(line)
    before = read_text(file, MOST_YAML)
    after = proposed_text(file, settings.actuators, found.entries, travel)
    if after is None:
        desk.say("The rows of the actuators are not in the file itself: change them by the report.")
    elif after != before:
        offer(file, before, after, desk)
    if open_ := [label for label in session.entries if label not in found.right]:
        desk.say(f"{len(open_)} of {len(session.entries)} actuators are not commissioned: {', '.join(open_[:8])}")
        desk.say(f"To try these again, when they are mended: hyperbit commission {file} {' '.join(open_[:8])}")
        raise typer.Exit(1)
    desk.say(f"all {len(session.entries)} actuators are commissioned")


def offer(file: Path, before: str, after: str, desk: Desk) -> None:
    """Shows the proposal, and writes it into the file after a copy, if it reads well and the person wants it."""
    path = file.with_name(f"{file.stem}.commission.diff")
    change = diff(file, before, after)
    write_whole(path, change.encode())
    desk.say(f"proposal, also in {path}:")
    for line in change.splitlines():
        desk.say(line)
    draft = file.with_name(f".{file.name}.proposed{file.suffix}")
    try:
        draft.write_text(after)
        read_wired(draft)
    except InputFaults as error:
        desk.say(f"the proposal does not fit yet: {error.faults[0]}; mend what the report names, and try again")
        return
    finally:
        draft.unlink(missing_ok=True)
    if desk.ask(f"write it into {file}, after a copy", (Choice("y", "yes"), Choice("n", "no"))) == "y":
        copy = next(p for k in range(1, 10_000) if not (p := file.with_name(f"{file.name}.bak-{k}")).exists())
        write_whole(copy, before.encode())
        write_whole(file, after.encode())
        desk.say(f"written; the file before is {copy}. An executor that runs needs a restart.")


def report(session: Session, found: Diagnosis, times: dict[str, dict[int, float]], single: list[str]) -> list[str]:
    """Returns the report as lines: faults of the wiring, and each actuator with what it did."""
    lines = [f"{len(found.findings)} faults of the wiring" if found.findings else "no fault of the wiring"]
    lines += [f"- {one.kind}: {one.text}{'' if one.proposed else ' (a person must mend it)'}" for one in found.findings]
    lines.append("actuator    verdict        extend [ms]  contract [ms]")
    for label in session.entries:
        tried = {one.state for one in session.sightings if one.actuator == label}
        verdict = "right" if label in found.right else "to mend" if tried == {0, 1} else "not tried"
        own = times[label]
        shown = [f"{1000 * own[to]:.1f}" if to in own else "-" for to in (1, 0)]
        lines.append(f"{label:<11} {verdict:<14} {shown[0]:>11}  {shown[1]:>13}")
    return lines + [f"own travel time of {line}" for line in single]


def present_travel(settings: ArmSettings) -> str:
    """Returns the travel time of the file as the proposal writes it."""
    times = settings.travel_time
    both = (times.contract, times.extend) if isinstance(times, TravelSettings) else (times, times)
    return written(dict(enumerate(both)))
