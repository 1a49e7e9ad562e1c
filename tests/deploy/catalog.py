"""Writes deploy/hyperbit.catalog, the explanations for `journalctl -x`. python -m tests.deploy.catalog"""

from hyperbit.controller.host.journal import message_id
from hyperbit.controller.panel.arms.faults import ADVICE
from hyperbit.controller.refusals.reasons import Reason
from tests.keys import DEPLOY

PATH = DEPLOY / "hyperbit.catalog"
SUPPORT = "file:///opt/hyperbit/doc/README.md"
FAULT = "At @HYPERBIT_SOURCE@ of the arm @HYPERBIT_ARM@. The running goal was ended, and the arm holds."
WARNINGS = (
    *("bus-passive", "board-limits", "outputs-off", "clock-set", "certificate-ends", "network-lost", "degraded"),
    *("journal", "unknown-position", "not-commissioned", "ledger-unwritten", "ledger-damaged"),
)
OTHERS = {
    "mode-starting": "The boards of the arm @HYPERBIT_ARM@ are booting. Nothing moves.",
    "mode-ready": "The arm @HYPERBIT_ARM@ holds and accepts goals.",
    "mode-executing": "The arm @HYPERBIT_ARM@ moves.",
    "mode-fault": "The arm @HYPERBIT_ARM@ holds and accepts no goals. The previous lines name the faults."
    " It continues by itself if all faults clear by themselves, otherwise after `hyperbit reset`.",
    "mode-stopped": "The arm @HYPERBIT_ARM@ was stopped by a request. It holds until `hyperbit reset`.",
    "fault-over": "The fault @HYPERBIT_FAULT@ at @HYPERBIT_SOURCE@ is gone.",
    "goal-succeeded": "The goal @HYPERBIT_GOAL@ was reached.",
    "goal-canceled": "The goal @HYPERBIT_GOAL@ was ended by `cancel`. The arm holds.",
    "goal-replaced": "Another goal or a stream of set-points replaced the goal @HYPERBIT_GOAL@.",
    "goal-aborted": "The goal @HYPERBIT_GOAL@ was ended by a fault, a stop or the end of the program, or was missed;"
    " code @HYPERBIT_CODE@. The arm holds.",
    "goal-lost": "Executor and planner ended while the goal @HYPERBIT_GOAL@ ran. How far it came is not known.",
}


def text() -> str:
    entries = {}
    for code, advice in ADVICE.items():
        action = str(advice).replace("Then hold Reset", "Then run `hyperbit reset`")
        where = "At @HYPERBIT_SOURCE@ of the arm @HYPERBIT_ARM@." if code in WARNINGS else FAULT
        entries[code] = (f"Fault {code} at @HYPERBIT_SOURCE@", f"{where}\n{action}")
    for kind, explanation in OTHERS.items():
        what, _, word = kind.partition("-")
        entries[kind] = (f"{what.capitalize()}: {word}", explanation)
    for reason in Reason:
        advice = reason.advice.replace("{arm}", "@HYPERBIT_ARM@")
        told = f"Advice: {advice}." if advice else "The message says what would be right."
        explanation = f"The goal @HYPERBIT_GOAL@ of the arm @HYPERBIT_ARM@ was refused, code @HYPERBIT_CODE@.\n{told}"
        entries[f"refused-{reason.value}"] = (f"Goal refused: {reason.value}", explanation)
    return "\n".join(
        f"-- {message_id(kind)}\nSubject: {subject}\nDefined-By: hyperbit\nSupport: {SUPPORT}\n\n{action}\n"
        for kind, (subject, action) in entries.items()
    )


if __name__ == "__main__":
    PATH.write_text(text())
