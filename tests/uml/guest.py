"""Runs this machine's share of the tests on vcan: python -m tests.uml.guest NUMBER

The number is the machine's. Its verdict is written to a folder that is common to the machines.
"""

import importlib
import sys
from pathlib import Path

from tests.vm.guest import ON_CAN, OPTIONS, compiled_since, run
from tests.vm.prepare import say

COMMON = Path("/mnt/common")  # mounted by `init`


def main() -> None:
    arguments = COMMON / "arguments"
    importlib.import_module("tests.vm.compile")
    code = run(1, [*OPTIONS, *ON_CAN, *arguments.read_text().splitlines()], COMMON)
    for path in compiled_since(arguments):
        say(f"compiled here, which is slow: {path}")
    (COMMON / f"verdict-{sys.argv[1]}").write_text(str(code))


if __name__ == "__main__":
    main()
