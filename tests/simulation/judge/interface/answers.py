"""Answers to accepted goals and jogs."""

from __future__ import annotations

from hyperbit.controller.program import unpack
from tests.simulation.judge.interface.account import InterfaceAccount
from tests.simulation.judge.interface.facts import Ran, Request
from tests.simulation.judge.verdict import require


def judge_jog(a: InterfaceAccount, request: Request, ran: Ran, text: str) -> None:
    """Compares the last stage of a jog with its request; the others stay where they are."""
    labels, last = a.modules.labels, unpack(ran.program.stages[-1].states)
    for label, state in request.body["actuators"].items():
        require(last >> labels.index(label) & 1 == (state == "extended"), f"{text} ends in {last:b}")
    mask = sum(1 << labels.index(label) for label in request.body["actuators"])
    others = (last ^ unpack(ran.program.start)) & ~mask
    require(not others, f"{text} switches {others:b} too")


def judge_homing(a: InterfaceAccount, request: Request, named: str | None, text: str) -> None:
    """Judges whether the answer says that a homing is not checked among obstacles."""
    heard = a.truths(a.now - request.at + 0.1)
    known = [unpack(h.snapshot.known) for h in heard if h.snapshot is not None]
    if named is not None:
        unknown = {label for mask in known for k, label in enumerate(a.modules.labels) if not mask >> k & 1}
        require(set(named.split(", ")) <= unknown, f"{text}; unknown were {unknown}")
        require(a.cubes or a.had("cubes", request.at - 0.1), f"{text}, and there is no obstacle")
    elif a.cubes and known and not a.had("cubes", request.at - 0.1):
        all_ = (1 << len(a.modules.labels)) - 1
        require(all_ in known, f"{text} does not say that its homing is not checked")
