"""Small arms whose every configuration can be tried, and hypothesis strategies of random ones."""

import numpy as np
from hypothesis import strategies as st

from hyperbit.controller.manipulator import frames
from hyperbit.controller.manipulator.frames import Frame
from hyperbit.controller.manipulator.joints import revolute
from hyperbit.controller.manipulator.manipulator import Manipulator
from hyperbit.controller.manipulator.module import Module, transforms
from hyperbit.controller.manipulator.vgt import vgt

coordinates = st.floats(-1, 1)
angles = st.floats(-np.pi, np.pi)
planar_frames = st.builds(frames.planar, coordinates, coordinates, angles)
quaternions = st.lists(coordinates, min_size=4, max_size=4).filter(lambda q: np.linalg.norm(q) > 0.1)
spatial_frames = st.builds(frames.spatial, st.lists(coordinates, min_size=3, max_size=3), quaternions)
any_frames = planar_frames | spatial_frames
origin = st.just(np.eye(4))


def listed(strategy: st.SearchStrategy[Frame], *, planar: bool, most: int = 5) -> st.SearchStrategy[Module]:
    """Modules of 2 to `most` states, each a frame of the strategy."""
    return st.lists(strategy, min_size=2, max_size=most).map(lambda states: transforms(states, planar=planar))


lengths = st.tuples(st.floats(0.18, 0.21), st.floats(0.22, 0.26))
vgts = st.builds(vgt, st.sampled_from(["BC", "AD"]), st.floats(0.18, 0.22), lengths, lengths, lengths)
joints = st.builds(revolute, st.just((0, 0, 1)), st.lists(angles, min_size=2, max_size=5), planar_frames)
planar_modules = vgts | joints | listed(planar_frames, planar=True)
modules = planar_modules | listed(spatial_frames, planar=False)


def short_arms(
    kinds: st.SearchStrategy[Module] = modules, bases: st.SearchStrategy[Frame] = origin, most: int = 4
) -> st.SearchStrategy[Manipulator]:
    """Arms of 1 to `most` modules."""
    return st.builds(Manipulator, st.lists(kinds, min_size=1, max_size=most), bases)


def paper_arm(count: int) -> Manipulator:
    """The truss arm of section 4 with `count` modules."""
    pair = [vgt(diagonal, 0.2, *[(0.2, 0.25)] * 3) for diagonal in ("BC", "AD")]
    return Manipulator([pair[i % 2] for i in range(count)])


def spatial_arm(count: int) -> Manipulator:
    """A spatial arm: every module bends to one of four sides or extends."""
    bends = [(0.2, 0, 0, 1), (-0.2, 0, 0, 1), (0, 0.2, 0, 1), (0, -0.2, 0, 1)]
    states = [frames.spatial((0, 0, 0.2), q) for q in bends] + [
        frames.spatial((0, 0, 0.25)),
        frames.spatial((0, 0, 0.2)),
    ]
    return Manipulator([transforms(states, planar=False)] * count)


def every_configuration(manipulator: Manipulator, first: int = 0) -> np.ndarray:
    """All configurations (n, B) of modules first+1 to B; the modules before them in state 0."""
    counts = (*[1] * first, *manipulator.states[first:])
    return np.indices(counts).reshape(len(counts), -1).T.copy()


def every_tip(manipulator: Manipulator, level: int = 0) -> np.ndarray:
    """All tips (n, 3) of modules level+1 to B in frame F_level."""
    upper = Manipulator(manipulator.modules[level:]) if level < len(manipulator.modules) else None
    return np.zeros((1, 3)) if upper is None else upper.tips(every_configuration(upper))[:, :3, 3]
