"""A user's program that uses each public name passes mypy --strict, see `make check`."""

import re
from pathlib import Path

import hyperbit as hb


def test_the_program_has_each_public_name():
    program = Path(__file__).with_name("users_program.py").read_text()
    assert set(re.findall(r"\bhb\.(\w+)", program)) == {*hb.__all__, "__version__"}
