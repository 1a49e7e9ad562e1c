"""The stream of set-points: the stages of the latest set-point."""

from hyperbit.controller.executor.arm.locked import LockedActuators
from hyperbit.controller.executor.motion.program_execution import StageMisfit, checked_states
from hyperbit.controller.program import Setpoint


class SetpointStream:
    """The latest set-point of a stream.

    Attributes:
        number: number of the stream.
        until: time after which the stream counts as stopped [s].
        reason: sentence on the set-point, for the mode.
        strict: no stage is skipped.
        start: states from which the stages were planned, with the locked states of locked actuators.
        stages: states at the end of each stage, likewise; empty: do not move.

    Args:
        message: the planner's message.
        most: actuators that may switch at once.
        locked: the locked actuators.
        actuators: number of actuators.

    Raises:
        StageMisfit: a stage does not fit the arm.
    """

    def __init__(self, message: Setpoint, most: int, locked: LockedActuators, actuators: int) -> None:
        self.number, self.until, self.reason, self.strict = (
            message.stream,
            message.until,
            message.reason,
            message.strict,
        )
        before = checked_states(message.start, actuators)
        self.start, self.stages = locked.aligned(before), list[int]()
        for states in (checked_states(packed, actuators) for packed in message.stages):
            if (states ^ before) & locked.mask:
                raise StageMisfit("a set-point switches a locked actuator", locked=True)
            if (states ^ before).bit_count() > most:
                raise StageMisfit(f"a stage of a set-point switches more than {most} actuators at once")
            self.stages.append(locked.aligned(states))
            before = states

    def due(self, outputs: int, most: int) -> int | None:
        """Returns the index of the stage to switch to; None if there is none, or they were planned from other states.

        Args:
            outputs: states that the outputs command.
            most: actuators that may switch at once.
        """
        if not self.stages or self.start != outputs:
            return None
        if self.strict:
            return 0
        near = (k for k, states in enumerate(self.stages) if (states ^ outputs).bit_count() <= most)
        return max(near, default=0)

    def record_reached(self, index: int) -> None:
        """Records that the outputs have reached a stage."""
        self.start, self.stages = self.stages[index], self.stages[index + 1 :]
