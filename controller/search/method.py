"""Methods by name: the search for fewest switches, and those of section 3.2."""

from typing import get_args

from controller.settings import Method as Method
from controller.settings import PaperMethod as PaperMethod

PAPER_METHODS: tuple[PaperMethod, ...] = get_args(PaperMethod)
METHODS: tuple[Method, ...] = ("minimum-switch", *PAPER_METHODS)
