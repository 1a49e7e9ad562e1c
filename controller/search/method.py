"""Methods by name: the search for fewest switches, and those of section 3.2."""

from typing import Literal, get_args

PaperMethod = Literal["pop", "ipop-previous", "ipop-contracted"]
Method = Literal["minimum-switch", PaperMethod]
PAPER_METHODS: tuple[PaperMethod, ...] = get_args(PaperMethod)
METHODS: tuple[Method, ...] = ("minimum-switch", *PAPER_METHODS)
