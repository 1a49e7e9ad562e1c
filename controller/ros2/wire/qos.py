"""Quality of service of an endpoint.

Zenoh delivers between any two settings. The settings decide how this side publishes or subscribes, and what tokens say.
"""

from typing import NamedTuple

_DEFAULT_DEPTH = 42  # rmw_zenoh's; an empty field has it


class Qos(NamedTuple):
    reliable: bool = True  # lost samples are sent again
    latched: bool = False  # a late subscriber receives the last `depth` samples; "transient local" in ROS 2
    depth: int = 10  # number of kept samples

    @property
    def text(self) -> str:
        """The field of a token: policies in the codes of rmw, depth and times; empty is rmw_zenoh's default."""
        depth = "" if self.depth == _DEFAULT_DEPTH else self.depth
        return f"{'' if self.reliable else 2}:{1 if self.latched else ''}:,{depth}:,:,:,,"


DEFAULT = Qos()
SENSOR_DATA = Qos(reliable=False, depth=5)
LATCHED = Qos(latched=True, depth=1)  # robot_description, maps, status of an action
TF = Qos(depth=100)
TF_STATIC = Qos(latched=True, depth=100)
