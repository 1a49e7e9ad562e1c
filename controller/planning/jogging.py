"""Single actuators switched on request, whatever the arm's configuration."""

import uuid
from collections.abc import Callable

import numpy as np

from controller.config import Arm
from controller.motion.codes import INVALID_GOAL, Refusal
from controller.motion.jog import STATES, decode
from controller.motion.pacing import pace_of
from controller.motion.program import in_groups, pack_states
from controller.planning.arm_state import ArmState
from controller.planning.keep_out import KeepOut
from controller.planning.messages import Reply, done
from controller.planning.reports import JogReport
from controller.planning.running_goal import RunningGoal
from controller.program import Program, Stage

Switches = dict[int, int]  # states by actuator

UNCHECKED = "; nobody knows what the arm touches meanwhile, as it is in no configuration"


class Jogging:
    """Makes programs of single actuators.

    Args:
        arm: whose actuators are switched.
        keep_out: the obstacles.
    """

    def __init__(self, arm: Arm, keep_out: KeepOut) -> None:
        self._manipulator, self._keep_out, self._pace = arm.manipulator, keep_out, pace_of(arm.settings)

    def decode(self, payload: bytes) -> Switches:
        """Returns the actuators of a request and their states.

        Raises:
            Refusal: the request is malformed.
        """
        return decode(payload, self._manipulator.actuators)

    def maker(self, wanted: Switches, reply: Reply) -> Callable[[ArmState, int, int], RunningGoal]:
        """Returns what makes the program of a request from the arm's state, with a number and an epoch.

        What is made raises Refusal if an actuator is locked or would touch something.
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
                raise Refusal(INVALID_GOAL, f"actuators: {labels[k]} is held: use it again with `degrade` first")
        target = state.commanded.copy()
        target[list(wanted)] = list(wanted.values())
        most = self._pace.inrush or len(labels)
        stages = in_groups(state.commanded, target, most)
        known = self._is_configuration(state)
        strict = known and not current.free
        if strict and (touched := current.touched(state.commanded, stages)) is not None:
            raise Refusal(INVALID_GOAL, f"on the way from where the arm is, {touched}")
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
        """Returns whether outputs and measured states are configurations."""
        return state.unknown_state is None and state.configuration is not None
