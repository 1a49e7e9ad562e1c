"""Writes deploy/hyperbit.catalog: what `journalctl -x` explains. python -m tests.deploy.catalog"""

from controller.journal import message_id
from controller.panel.faults import ADVICE
from tests.keys import DEPLOY

PATH = DEPLOY / "hyperbit.catalog"
SUPPORT = "file:///opt/hyperbit/doc/README.md"
FAULT = "At @HYPERBIT_SOURCE@ of the arm @HYPERBIT_ARM@. The running goal was ended, and the arm holds."
WARNINGS = ("bus-passive", "board-limits", "clock-set", "network-lost", "degraded", "journal", "unknown-position")
OTHERS = {
    "mode-starting": "The boards of the arm @HYPERBIT_ARM@ are being booted. Nothing moves by that.",
    "mode-ready": "The arm @HYPERBIT_ARM@ holds and takes goals.",
    "mode-executing": "The arm @HYPERBIT_ARM@ moves.",
    "mode-fault": "The arm @HYPERBIT_ARM@ holds and takes no goals. The lines before this one name the faults."
    " It goes on by itself if all of them clear by themselves, else after `hyperbit reset`.",
    "mode-stopped": "Somebody stopped the arm @HYPERBIT_ARM@. It holds until `hyperbit reset`.",
    "fault-over": "The fault @HYPERBIT_FAULT@ at @HYPERBIT_SOURCE@ is over.",
    "goal-succeeded": "The goal @HYPERBIT_GOAL@ was reached.",
    "goal-canceled": "The goal @HYPERBIT_GOAL@ was ended by `cancel`. The arm holds.",
    "goal-replaced": "Another goal or a stream of set-points took the place of @HYPERBIT_GOAL@.",
    "goal-aborted": "The goal @HYPERBIT_GOAL@ was ended by a fault, a stop or the end of the program, or was missed;"
    " code @HYPERBIT_CODE@. The arm holds.",
}


def text() -> str:
    """The whole catalogue."""
    entries = {}
    for code, advice in ADVICE.items():
        told = advice.replace("Then hold Reset", "Then run `hyperbit reset`")
        where = "At @HYPERBIT_SOURCE@ of the arm @HYPERBIT_ARM@." if code in WARNINGS else FAULT
        entries[code] = (f"Fault {code} at @HYPERBIT_SOURCE@", f"{where}\n{told}")
    for kind, told in OTHERS.items():
        what, _, word = kind.partition("-")
        entries[kind] = (f"{what.capitalize()}: {word}", told)
    return "\n".join(
        f"-- {message_id(kind)}\nSubject: {subject}\nDefined-By: hyperbit\nSupport: {SUPPORT}\n\n{told}\n"
        for kind, (subject, told) in entries.items()
    )


if __name__ == "__main__":
    PATH.write_text(text())
