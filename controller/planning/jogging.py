"""Switches single actuators on request, in any configuration or none."""

import uuid
from collections.abc import Callable

import numpy as np

from controller.config import Arm
from controller.manipulator.locked import STATES
from controller.motion.codes import INVALID_GOAL, Refusal
from controller.motion.pacing import pace_of
from controller.motion.program import in_groups, pack_states
from controller.motion.requests import decode_jog
from controller.planning.arm_state import ArmState
from controller.planning.keep_out import KeepOut
from controller.planning.messages import Reply, done
from controller.planning.reports import JogReport
from controller.planning.running_goal import RunningGoal
from controller.program import Program, Stage

Switches = dict[int, int]  # new state of each actuator, by index

UNCHECKED = "; collisions were not checked, because the arm is in no configuration"


class Jogging:
    """Makes programs that switch single actuators.

    Args:
        arm: the arm.
        keep_out: the obstacles.
    """

    def __init__(self, arm: Arm, keep_out: KeepOut) -> None:
        self._manipulator, self._keep_out, self._pace = arm.manipulator, keep_out, pace_of(arm.settings)

    def decode(self, payload: bytes) -> Switches:
        """Returns the new states of a request, by actuator.

        Raises:
            Refusal: the request is malformed.
        """
        return decode_jog(payload, self._manipulator.actuators)

    def maker(self, wanted: Switches, reply: Reply) -> Callable[[ArmState, int, int], RunningGoal]:
        """Returns a function that makes the program of a request from the arm's state, a number and an epoch.

        The function raises Refusal if an actuator is locked or a stage would collide.
        """
        name = f"jog-{uuid.uuid4().hex[:8]}"

        def make(state: ArmState, number: int, epoch: int) -> RunningGoal:
            return self._program(state, number, epoch, wanted, name, reply)

        return make

    def _program(
        self, state: ArmState, number: int, epoch: int, wanted: Switches, name: str, reply: Reply
    ) -> RunningGoal:
        labels, current = self._manipulator.actuators, self._keep_out.current
        for k in wanted:
            if state.locked[k]:
                raise Refusal(INVALID_GOAL, f"actuators: {labels[k]} is locked: unlock it with `degrade` first")
        target = state.commanded.copy()
        target[list(wanted)] = list(wanted.values())
        most = self._pace.inrush or len(labels)
        stages = in_groups(state.commanded, target, most)
        known = self._is_configuration(state)
        strict = known and not current.free
        if strict and (collision := current.first_collision(state.commanded, stages)) is not None:
            raise Refusal(INVALID_GOAL, f"the motion from the arm's present state would collide: {collision}")
        last, lead = len(stages) - 1, self._pace.lead
        packed = state.pack(stages)
        program = Program(
            number,
            epoch,
            state.snapshot.outputs,
            0.0,
            tuple(Stage(states, k * lead, 0 if k == last else -1) for k, states in enumerate(packed)),
            True,
            strict,
            f"jog {name}",
            (report := JogReport(self._manipulator, name, target, list(wanted))).context,
            homed=pack_states(np.isin(np.arange(len(labels)), list(wanted)).astype(np.uint8)[None, :])[0],
        )
        run = RunningGoal(program, report, None)
        words = ", ".join(f"{labels[k]} {STATES[to]}" for k, to in wanted.items())
        unchecked = UNCHECKED if not known and not current.free else ""
        message = f"accepted, {np.count_nonzero(state.commanded != target)} switches: {words}{unchecked}"
        run.on_accepted = lambda: reply({**done(message[:1_000]), "id": name})
        return run

    def _is_configuration(self, state: ArmState) -> bool:
        """Returns whether outputs and measured states spell configurations."""
        return state.unknown_state is None and state.configuration is not None
