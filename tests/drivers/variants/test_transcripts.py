"""Exact frames of the boot of each variant and of one commit.

The frames of the standard board are in transcripts/standard.txt; of the others, what differs from these.
`python -m tests.drivers.variants.test_transcripts` writes them anew.
"""

from __future__ import annotations

import difflib
from pathlib import Path

import pytest

from tests.drivers.canopen.run.test_frames import spoken
from tests.drivers.variants.cases import CASES, Case
from tests.drivers.variants.test_boots import booted, case_of

FOLDER = Path(__file__).with_name("transcripts")
STANDARD = FOLDER / "standard.txt"


def transcript(case: Case) -> str:
    """Returns the frames of a boot, and of a commit until it is read back, without heartbeats and guarding."""
    world = booted(case)
    if world.master.outputs_known:
        world.commit(1, 1)
        world.until(lambda: not world.master.unread)
    return spoken(world)


def difference(text: str, standard: str) -> str:
    """Lines that are not in the standard board's transcript, or missing in it, with their places, and all lines' count.

    Of a boot that is given up, what the standard board says later does not count as missing.
    """
    lines, others = text.splitlines(), standard.splitlines()
    blocks = difflib.SequenceMatcher(None, others, lines, autojunk=False).get_matching_blocks()
    if len(lines) < len(others) - 10:
        others = others[: max(block.a + block.size for block in blocks[:-1])]
    differing = list(difflib.unified_diff(others, lines, n=0, lineterm=""))[2:]
    return "".join(f"{line}\n" for line in [*differing, f"{len(lines)} lines"])


def test_frames_of_the_standard_board():
    """Each line was compared with CiA 301 and 401: reads, what differs is written and read back, start, reads."""
    assert transcript(case_of("standard")) == STANDARD.read_text()


@pytest.mark.parametrize("case", CASES[1:], ids=lambda case: case.name)
def test_frames_that_differ(case):
    assert difference(transcript(case), STANDARD.read_text()) == (FOLDER / f"{case.name}.diff").read_text()


if __name__ == "__main__":
    STANDARD.write_text(transcript(case_of("standard")))
    for other in CASES[1:]:
        (FOLDER / f"{other.name}.diff").write_text(difference(transcript(other), STANDARD.read_text()))
