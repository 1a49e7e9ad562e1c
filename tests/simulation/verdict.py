"""The judge's verdict: an exception with the sentence that is violated."""


class Violation(BaseException):
    """The daemon did or told what it must not, or not what it must. The daemon catches each `Exception`."""


def require(holds: object, text: str) -> None:
    if not holds:
        raise Violation(text)
