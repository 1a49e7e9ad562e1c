"""What the executor does and says in a scenario: the steps that begin with `executor`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from hyperbit.controller.program import Answer, Fault, Question, Replaced, Travel, pack
from hyperbit.controller.refusals.reasons import Reason
from hyperbit.controller.refusals.refusal import Refused

if TYPE_CHECKING:
    from tests.planning.rig.play import Play


def do(play: Play, did: str, words: list[str], said: str) -> None:
    executor = play.executor
    match did, words:
        case "accepts", []:
            play.running = play.program
            executor.accept(play.program)
        case "declines", [reason, *fact]:
            executor.decline(play.program, Reason(reason), **dict.fromkeys(fact, said))
        case "runs", [stage, *fields]:
            given = _pairs(fields)
            at = given.get("at")
            executor.run(play.running, int(stage), int(given.get("switches", 1)), at and play.packed(at))
        case "ends", _:
            _end(play, words, said)
        case "repeats", []:
            executor.send(play.ended)
        case (("answers" | "refuses"), _):
            executor.answer(play.asked, said, did == "answers", **_fields(play, words))
        case "locked", []:  # a refusal of a lock, without a new epoch
            refused = Refused(Reason.LOCK_WHILE_MOVING, {"mode": "executing"})
            executor.send(Answer(play.asked.request, "", refused))
        case "shows", _:
            play.desk.show(**_fields(play, words))
        case "fault", ["over"]:
            play.desk.show(faults=())
        case "fault", [code, source]:
            play.desk.show(faults=(Fault(code, source, said),))
        case "follows", []:  # the arm is where the last stage leads
            play.desk.show(outputs=play.setpoint.stages[-1])
        case "replaces", []:
            executor.send(Replaced(play.running.program, play.replaced.generation, True))
        case "asks", [start, stage]:
            play.questions += 1
            executor.send(Question(play.questions, play.packed(start), play.packed(stage)))
        case "dies", []:
            play.desk.drop(said or "the executor closed the connection")
        case "greets", []:
            executor.greet(play.program.program if play.program else 0)
        case "tells", []:
            executor.send(Answer(play.asked.request, said))
        case "changes", []:
            executor.instance += 1
        case "restarts", []:
            executor.instance += 1
            executor.greet()
        case _:
            raise ValueError(f"the executor cannot: {did} {' '.join(words)}")


def _end(play: Play, words: list[str], said: str) -> None:
    """Ends the program: with a status first, "done" without one, then fields."""
    program, status = play.running or play.program, "done"
    if len(words) % 2:
        status, *words = words
    given = _pairs(words)
    more: dict[str, Any] = {name: int(given[name]) for name in ("mark", "switches") if name in given}
    more.setdefault("mark", program.stages[-1].mark if status == "done" else -1)
    if "verified" in given:
        more["verified"] = False
    if "travels" in given:
        more["travels"] = (Travel(5, 1, float(given["travels"])),)
    if "at" in given:
        more["measured"] = play.packed(given["at"])
    play.ended = play.executor.end(program, status, said or "done", **more)


def _fields(play: Play, words: list[str]) -> dict[str, Any]:
    """Returns fields of a snapshot; masks are binary numbers, "all-11" is all but those of one."""
    size = play.executor.actuators
    fields: dict[str, Any] = {}
    for name, word in _pairs(words).items():
        if name in ("mode", "reason"):
            fields[name] = word
        elif name == "epoch":
            fields[name] = int(word)
        elif name == "moving":
            fields[name] = word == "yes"
        elif name == "free_in":
            fields["free_at"] = play.desk.now + float(word)
        elif word.startswith("all"):
            fields[name] = pack(((1 << size) - 1) & ~int(word[4:] or "0", 2), size)
        elif word.isdecimal():
            fields[name] = pack(int(word, 2), size)
        else:
            fields[name] = play.packed(word)
    return fields


def _pairs(words: list[str]) -> dict[str, str]:
    return dict(zip(words[::2], words[1::2], strict=True))
