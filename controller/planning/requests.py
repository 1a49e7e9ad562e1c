"""Requests that go straight to the executor: cancel, stop, reset, and locks. None of them waits."""

from collections.abc import Callable

from controller.motion.codes import INVALID_GOAL
from controller.motion.requests import DegradeMessage
from controller.planning.admission import Admission
from controller.planning.connection import NotConnected
from controller.planning.goals import RunningGoals
from controller.planning.link import ExecutorLink
from controller.planning.locked import LockedActuators
from controller.planning.messages import Reply, done, refused
from controller.planning.monitor import ArmMonitor
from controller.program import Answer, Cancel, Down, Halt, Lock, Reset

CANCELED = "canceled; the arm holds"


class Requests:
    """Sends requests to the executor, and replies with its answers. For any thread.

    Args:
        link: to the executor.
        monitor: of the arm.
        admission: bars the requests before a cancel, stop or reset.
        goals: the running goals.
        locked: locked actuators.
    """

    def __init__(
        self,
        link: ExecutorLink,
        monitor: ArmMonitor,
        admission: Admission,
        goals: RunningGoals,
        locked: LockedActuators,
    ) -> None:
        self._link, self._monitor, self._admission = link, monitor, admission
        self._goals, self._locked = goals, locked

    def cancel(self, reply: Reply) -> None:
        """Makes the arm hold now, and bars all earlier requests."""
        self._bar(lambda request: Cancel(request, None, CANCELED), reply)

    def stop(self, reply: Reply) -> None:
        """Stops the arm until a reset."""
        self._bar(Halt, reply)

    def reset(self, reply: Reply) -> None:
        """Leaves a fault or a stop; starts another attempt to rebuild tables that could not be rebuilt."""
        if self._locked.problem is not None:
            self._locked.retry()
        if self._monitor.mode()[0] in ("fault", "stopped"):
            self._bar(Reset, reply)
        else:  # nothing to reset: earlier requests may continue
            self._ask(Reset, reply)

    def lock(self, request: DegradeMessage, reply: Reply) -> None:
        """Locks an actuator in a state, or unlocks it; the executor refuses this while the arm moves."""
        state = self._monitor.state
        if state is None:
            mode, reason = self._monitor.mode()
            reply(refused(INVALID_GOAL, f"the arm is {mode}: {reason}"))
            return
        refusal = self._locked.refusal(request, state.measured, state.sensed)
        if refusal is not None:
            reply(refused(INVALID_GOAL, refusal))
            return
        actuator = self._monitor.manipulator.actuators.index(request.actuator)
        to = -1 if request.state is None else request.state
        self._admission.fence()
        self._ask_for_epoch(lambda request: Lock(request, actuator, to), reply)

    def _bar(self, make: Callable[[int], Down], reply: Reply) -> None:
        """Bars all earlier requests, and sends a request that begins a new epoch."""
        self._admission.bar()
        self._ask_for_epoch(make, reply)

    def _ask_for_epoch(self, make: Callable[[int], Down], reply: Reply) -> None:
        if not self._ask(make, reply, self._admission.answered):
            self._admission.unsent()

    def _ask(self, make: Callable[[int], Down], reply: Reply, heard: Callable[[], None] = lambda: None) -> bool:
        """Sends a request and replies with the answer; returns whether the request was sent."""

        def on_answer(answer: Answer | None) -> None:
            if answer is None:
                reply(
                    refused(
                        INVALID_GOAL,
                        f"the connection to the executor was lost before it answered: {self._link.problem}",
                    )
                )
                return
            heard()
            reply(done(answer.message) if answer.accepted else refused(INVALID_GOAL, answer.message))

        try:
            self._link.ask(make, on_answer)
        except NotConnected as error:
            reply(refused(INVALID_GOAL, f"the executor is not connected: {error}"))
            return False
        return True
