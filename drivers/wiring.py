"""The wiring of an arm; see `drivers.canopen.wiring`."""

from drivers.canopen.wiring import MASTER as MASTER
from drivers.canopen.wiring import BusSettings as BusSettings
from drivers.canopen.wiring import Channel as Channel
from drivers.canopen.wiring import Timing as Timing
from drivers.canopen.wiring import Wiring as Wiring
