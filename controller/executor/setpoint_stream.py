"""A followed set-point: the stages on the way to what it asks for, until the next one comes."""

from controller.executor.locked import LockedActuators
from controller.executor.program_execution import Misfit, checked_states
from controller.program import Setpoint


class SetpointStream:
    """What a stream of set-points asks for now.

    Attributes:
        number: of the stream.
        until: when the stream has stopped [s].
        reason: a sentence on what is followed.
        strict: no stage is left out.
        start: outputs from which the stages were planned; here and in stages, locked actuators have their states.
        stages: states that each stage ends in; empty: stay.

    Args:
        message: of the planner.
        most: actuators that may switch at once.
        locked: the locked actuators.
        actuators: number.

    Raises:
        Misfit: its stages do not fit the arm.
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
                raise Misfit("a set-point switches a locked actuator", locked=True)
            if (states ^ before).bit_count() > most:
                raise Misfit(f"a stage of a set-point switches more than {most} actuators at once")
            self.stages.append(locked.aligned(states))
            before = states

    def due(self, outputs: int, most: int) -> int | None:
        """Returns the stage to switch to; None if the stages are planned from other outputs, or there are none.

        Args:
            outputs: states.
            most: actuators that may switch at once.
        """
        if not self.stages or self.start != outputs:
            return None
        if self.strict:
            return 0
        near = (k for k, states in enumerate(self.stages) if (states ^ outputs).bit_count() <= most)
        return max(near, default=0)

    def took(self, index: int) -> None:
        """Notes that the outputs have reached a stage."""
        self.start, self.stages = self.stages[index], self.stages[index + 1 :]
