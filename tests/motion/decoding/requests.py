"""Strategies for JSON payloads, valid and invalid."""

from hypothesis import strategies as st

FIELDS = [
    "waypoints", "position", "t", "orientation", "tolerance", "stamp", "id", "path_tolerance", "actuator", "state",
    "actuators", "1.left", "extended", "regions", "disc", "sphere", "box", "centre", "radius", "size", "name",
]  # fmt: skip
texts = st.text(st.characters(exclude_categories=[]), max_size=8)  # with lone surrogates, which JSON can contain
keys = texts | st.sampled_from(FIELDS)
json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | keys,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(keys, inner, max_size=4),
    max_leaves=12,
)
