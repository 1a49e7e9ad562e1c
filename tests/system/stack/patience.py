"""Planners of tests on a slow machine, which wait longer for the executor's answer. To import this module is enough."""

from hyperbit.controller.planning.core import goals, requests
from tests.waiting import SLOWNESS

goals.EXECUTOR_TIMEOUT *= SLOWNESS
requests.EXECUTOR_TIMEOUT *= SLOWNESS
