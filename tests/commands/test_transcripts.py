"""What commands print and how they end without a daemon; see transcript.py."""

from pathlib import Path

import pytest

from tests.commands import transcript
from tests.commands.transcript import Hyperbit

TRANSCRIPTS = transcript.read(daemon=False)


@pytest.mark.parametrize("title", TRANSCRIPTS)
def test_commands_print_and_end_as_in_their_transcript(title: str, folder: Path, hyperbit: Hyperbit) -> None:
    transcript.play(TRANSCRIPTS[title], folder, hyperbit)
