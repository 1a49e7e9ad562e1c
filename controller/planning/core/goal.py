"""A goal or jog from its arrival to its result."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

if TYPE_CHECKING:
    from hyperbit.controller.motion.decoding.goal import GoalMessage, Jog
    from hyperbit.controller.motion.stages.feed import Feed
    from hyperbit.controller.planning.core.arm import ArmState, States
    from hyperbit.controller.planning.core.parts import Ticket
    from hyperbit.controller.planning.core.reports import GoalOutcome, Report
    from hyperbit.controller.planning.core.tasks import Basis, Planned
    from hyperbit.controller.program import Ended, Program, Settled
    from hyperbit.controller.refusals.refusal import Refusal


@dataclass(eq=False)
class Goal:
    """A goal or jog. It belongs to `Goals` until the executor has accepted it, then to `Programs`."""

    request: int
    ticket: Ticket
    wanted: GoalMessage | Jog
    id: str
    received: float  # time of arrival [UNIX s]
    begin_by: float  # time by which the executor must accept it [s]
    since: float  # when the present wait began [s]
    state: Literal["waiting", "offered", "running"] = "waiting"
    job: int | None = None  # number of the task that plans, checks or improves it

    # --- while it waits
    basis: Basis | None = None  # what the plan holds for
    planned: Planned | States | None = None  # plan, or stages (k, A) of a jog; None: none for the present basis
    waits: ArmState | None = None  # the snapshot after which it is offered again; None: it does not wait for one
    plan_by: float | None = None  # end of its planning by its own deadline [s]; None: it has not begun, or has none
    why: Refusal | None = None  # why it was planned or offered again, and would be refused then

    # --- from its offer on, see `offers`
    program: Program = field(init=False)  # as it was sent
    report: Report = field(init=False)
    feed: Feed = field(init=False)
    answer: dict[str, Any] = field(init=False)  # waits until the ledger has the acceptance
    delay: float = 0.0  # the trajectory's t = 0 in the program's time [s]
    unchecked: bool = False  # whether it cannot be checked, because it is not known where the arm is

    # --- from its acceptance on
    begin: float = 0.0  # the program's zero of time [s]
    unrecorded: int | None = None  # entry of the acceptance that the ledger does not have yet
    outcome: GoalOutcome | None = None  # the planner's reason to end it; the executor's result follows
    deviates: bool = False  # whether the deviations of its points are still awaited
    held: deque[Settled | Ended] = field(default_factory=deque)  # reports that wait for the deviations, in order
    checking: int | None = None  # number of the task that checks its next stages
    switches: int = 0  # as the executor told last
