"""Boards without 6206h and 6207h: whether their `error_state` does what `on_loss` asks of each actuator."""

from typing import Literal

from hyperbit.controller.armfile.names import shortened
from hyperbit.controller.armfile.settings import ActuatorSettings, ArmSettings, ErrorState
from hyperbit.controller.armfile.terminals import bit_settings

OffMotion = Literal["contracts", "extends", "stays", "both on"]

WOULD = {
    "contracts": "would contract when its outputs go off",
    "extends": "would extend when its outputs go off, for `output` is inverted",
    "stays": "would stay where it is when both its outputs go off",
    "both on": "would have both its outputs on, for both are inverted",
}
OTHER_BOARD = "or a board with 6206h and 6207h, without error_state"


def error_state(setting: ErrorState | None) -> Literal["off", "hold", "device"] | None:
    """Returns the meaning of the setting: YAML reads a plain `off` as false; true has no meaning."""
    if isinstance(setting, bool):
        return None if setting else "off"
    return setting


def check_error_states(settings: ArmSettings, faults: list[str]) -> None:
    """Appends a fault for each `error_state` with which actuators cannot do what `on_loss` asks, and names them."""
    found: dict[tuple[str, str | None, str], list[str]] = {}
    boards = settings.boards
    nodes = {(node.bus, node.node): (k, node.error_state) for k, node in enumerate(boards.nodes)}
    for entry in settings.actuators:
        where, setting = "boards", boards.error_state
        k, own = nodes.get((entry.bus, entry.node), (0, None))
        if own is not None:
            where, setting = f"boards.nodes[{k}]", own
        state = error_state(setting)
        why = contradiction(entry, entry.on_loss or boards.on_loss, state)
        if why is not None:
            found.setdefault((where, state, why), []).append(f"{entry.module}.{entry.actuator}")
    for (where, told, why), labels in found.items():
        who = f"actuator {labels[0]}" if len(labels) == 1 else f"each of the actuators {shortened(labels)}"
        faults.append(f"{where}.error_state: {told}, but {who} {why}")


def contradiction(entry: ActuatorSettings, on_loss: str, state: str | None) -> str | None:
    """Returns why an actuator cannot do what `on_loss` asks, and what would be right; None if it can.

    `off` is right where outputs that are electrically off contract the actuator (`contract`) or leave it where it is
    (`hold`). `hold` and `device` are right with `hold`, without pulses: a board that holds ends no pulse.

    Args:
        entry: the actuator.
        on_loss: "hold" or "contract".
        state: what the outputs of its board do without the master; None: unknown, so the board needs 6206h and 6207h.
    """
    contract = on_loss == "contract" and entry.pulse is None  # pulses with `contract` are refused elsewhere
    if state == "off":
        does = motion_when_off(entry)
        if does == ("contracts" if contract else "stays"):
            return None
        return f"is to {'contract' if contract else 'hold'} (on_loss), and {WOULD[does]}; {_needed(entry, does)}"
    if state is None:
        return None
    if entry.pulse is not None:
        return "has pulses: an output that is on then would stay on; off is needed"
    if contract:
        return f"is to contract (on_loss), which `{state}` does not ensure; off is needed, {OTHER_BOARD}"
    return None


def motion_when_off(entry: ActuatorSettings) -> OffMotion:
    """Returns what an actuator does when its outputs are electrically off; an inverted output then has the level 1."""
    extending = bit_settings(entry.output).inverted
    if entry.output_off is None:
        return "extends" if extending else "contracts"
    contracting = bit_settings(entry.output_off).inverted
    if extending and contracting:
        return "both on"
    if extending or contracting:
        return "extends" if extending else "contracts"
    return "stays"


def _needed(entry: ActuatorSettings, does: OffMotion) -> str:
    if does == "stays":
        return f"on_loss: hold is needed, {OTHER_BOARD}"
    if does == "contracts" and entry.pulse is None:
        return f"on_loss: contract is needed, {OTHER_BOARD}"
    return f"outputs that are not inverted are needed, {OTHER_BOARD}"
