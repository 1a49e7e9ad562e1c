"""The nursery of processes that kill at chosen steps: python -m tests.system.kills.nursery planner ARM.yaml"""

import os
import sys
from pathlib import Path

from tests.system.stack import nursery


def run(arguments: list[str]) -> int:
    """The process of `hyperbit run`, with a trigger."""
    from tests.system.kills.trigger import install

    install(Path(os.environ["STATE_DIRECTORY"]))
    return nursery.run(arguments)


if __name__ == "__main__":
    nursery.COMMANDS["planner"] = run
    nursery.main(*sys.argv[1:])
