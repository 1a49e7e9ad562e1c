"""Strategies for JSON payloads, valid and invalid."""

from hypothesis import strategies as st

from hyperbit.controller.motion.decoding.payloads import MOST_BYTES

texts = st.text(st.characters(exclude_categories=[]), max_size=8)  # with lone surrogates, which JSON can contain
json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | texts,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(texts, inner, max_size=4),
    max_leaves=12,
)
scalars = st.none() | st.booleans() | st.integers(-2, 2) | st.floats() | st.text(max_size=5)


def unreadable(request: str, most: int = MOST_BYTES) -> list[tuple[bytes, str]]:
    """Payloads that are no JSON, and the refusal of each."""
    return [
        (b"", f"{request} is not JSON"),
        (b"\xff", f"{request} is not UTF-8: byte 0 is 0xff"),
        (b"[" * 5000, f"{request} is not JSON"),
        (bytes(most + 1), f"{request} of {most + 1} bytes, at most {most} are accepted"),
    ]
