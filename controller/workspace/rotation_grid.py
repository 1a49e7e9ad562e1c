"""A grid of rotations for convolution: even, closed under the turns of a cube, and true to the mean.

The 24 rotations that bring a cube onto itself move pixels onto pixels. The grid is those turns, each followed by the
rotations of a small even lattice about the identity, so that turning by any of the grid costs no more resampling than
turning by the few of the lattice.

A rotation between those of the grid is shared among the nearest, some shares negative, so that the mean of their
matrices is the matrix itself. The mean frame of joined segments is the product of their mean frames: what is true of
every share stays true of the convolution, however coarse the grid, and no rotation diffuses.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]

CUBE: Array = Rotation.create_group("O").as_matrix().round()  # its 24 turns
EDGE = 2 * (np.sqrt(2) - 1)  # of the cube of Rodrigues vectors, tan(angle / 2) times axis, nearest to the identity
NEAREST = 28  # rotations that share one between them; ten constraints, and 24 can lie so that they do not suffice
ONE = 1e-9  # square of a distance that is none: what is in the grid is shared with nobody
WINDOW = 1.1  # times the distance of the farthest of them, where its share would be 0


@dataclass(frozen=True)
class RotationGrid:
    """24 `along`^3 rotations: number o m + c is turn o of the cube after lattice rotation c, m = `along`^3.

    Attributes:
        along: lattice rotations along the edge of each of 24 cubes; their angle is some 90 degrees / `along`.
    """

    along: int

    @cached_property
    def lattice(self) -> Array:
        """Matrices of the rotations about the identity, shape (m, 3, 3)."""
        line = EDGE * ((np.arange(self.along) + 0.5) / self.along - 0.5)
        return np.asarray(Rotation.from_quat([(*r, 1.0) for r in product(line, repeat=3)]).as_matrix())

    @cached_property
    def rotations(self) -> Array:
        """Matrices of all rotations, shape (24 m, 3, 3)."""
        return (CUBE[:, None] @ self.lattice).reshape(-1, 3, 3)

    @cached_property
    def tree(self) -> KDTree:
        """All rotations as quaternions, and once more as their negatives."""
        quaternions = Rotation.from_matrix(self.rotations).as_quat()
        return KDTree(np.vstack((quaternions, -quaternions)))

    def shares(self, rotations: Array) -> tuple[NDArray[np.int64], Array]:
        """Returns which rotations of the grid share each given matrix (n, 3, 3), and how much of it, shape (n, 28).

        Of all shares whose sum is 1 and whose mean is the matrix, the least in squares, near ones weighted more.
        """
        distances, found = self.tree.query(Rotation.from_matrix(rotations).as_quat(), NEAREST)
        cells = found % len(self.rotations)
        seen = rotations[:, None].swapaxes(2, 3) @ self.rotations[cells] - np.eye(3)
        wanted = np.concatenate((np.ones((*cells.shape, 1)), seen.reshape(*cells.shape, 9)), axis=2)
        window = (1 - (distances / (WINDOW * distances[:, -1:])) ** 2) ** 2 / (distances**2 + ONE)
        root = np.sqrt(window)[:, :, None]
        basis, triangle = np.linalg.qr(root * wanted)
        first = np.broadcast_to(np.eye(10)[:, :1], (len(cells), 10, 1))
        return cells, (root * basis @ np.linalg.solve(triangle.swapaxes(1, 2), first))[:, :, 0]

    @cached_property
    def after(self) -> list[csr_array]:
        """For each lattice rotation c, what each rotation of the grid gets of c times each, shape (24 m, 24 m)."""
        number = len(self.rotations)
        columns = np.repeat(np.arange(number), NEAREST)
        mixed = []
        for rotation in self.lattice:
            cells, shares = self.shares(rotation @ self.rotations)
            mixed.append(csr_array((shares.ravel(), (cells.ravel(), columns)), shape=(number, number)))
        return mixed


def turned(boxes: Array, turn: Array) -> Array:
    """Returns cubes of pixels about the origin, shape (..., z, y, x), turned by one of CUBE's turns (3, 3)."""
    lead = boxes.ndim - 3
    sources = np.abs(turn).argmax(axis=1)  # x, y, z of the result come from these
    result = boxes.transpose([*range(lead), *(lead + 2 - sources[::-1])])
    return np.asarray(np.flip(result, tuple(lead + 2 - a for a in range(3) if turn[a, sources[a]] < 0)))
