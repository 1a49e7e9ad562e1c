"""The public Python API; see controller/library, whose names these are."""

from hyperbit.controller.library import *  # noqa: F403
from hyperbit.controller.library import __all__ as __all__
from hyperbit.controller.library import __doc__ as __doc__
