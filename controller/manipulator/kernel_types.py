"""Types of the arguments of kernels: C-contiguous arrays, and NamedTuples of arrays; options of kernels.

F2 is float64 with two dimensions, I1 is int64 with one, S1 is int32 with one. Signatures consist of them, so that
nothing is compiled while the arm moves.
"""

from typing import Any

from numba import float64, int32, int64, types

F1, F2, F3, F4, F5 = float64[::1], float64[:, ::1], float64[:, :, ::1], float64[:, :, :, ::1], float64[:, :, :, :, ::1]
I1, I2 = int64[::1], int64[:, ::1]
S1 = int32[::1]

# Options of small kernels that allocate nothing. numba counts the references of each array that a kernel takes from a
# NamedTuple or slices. In small kernels this takes several times as long as the arithmetic, and `_nrt` switches it off.
UNCOUNTED: dict[str, Any] = {"_nrt": False}


def named(kind: type, *parts: Any) -> Any:
    """Returns the numba type of a NamedTuple from the types of its fields."""
    return types.NamedTuple(parts, kind)  # type: ignore[no-untyped-call]
