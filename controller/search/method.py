"""The methods of section 3.2 by name."""

from typing import Literal, get_args

Method = Literal["pop", "ipop-previous", "ipop-contracted"]
METHODS: tuple[Method, ...] = get_args(Method)
