"""Liveliness tokens, from which ROS 2 learns which nodes and endpoints exist, and the GIDs that are made of them."""

from enum import StrEnum
from typing import NamedTuple

import xxhash

from hyperbit.controller.ros2.wire import qos
from hyperbit.controller.ros2.wire.names import demangle, mangle
from hyperbit.controller.ros2.wire.qos import BadQos, Qos

ADMIN_SPACE = "@ros2_lv"
NODE_PARTS, ENDPOINT_PARTS = 9, 13


class Kind(StrEnum):
    """What a token stands for."""

    NODE = "NN"
    PUBLISHER = "MP"
    SUBSCRIBER = "MS"
    SERVICE = "SS"
    CLIENT = "SC"


class BadToken(ValueError):
    """A key is no token of rmw_zenoh."""


class Endpoint(NamedTuple):
    """What an endpoint's token has beside its node.

    Attributes:
        name: absolute name of the topic or service.
        type: its DDS name, such as std_msgs::msg::dds_::String_.
        hash: RIHS01 hash of the type.
        qos: quality of service.
    """

    name: str
    type: str
    hash: str
    qos: Qos


class Token(NamedTuple):
    """One liveliness token.

    Attributes:
        domain: ROS_DOMAIN_ID.
        zid: id of the Zenoh session.
        nid: the node's number in its session.
        id: the node's or endpoint's number in its session.
        kind: what exists.
        node: the node's name.
        namespace: of the node; "/" if it has none.
        enclave: of the node; "/" if it has none.
        endpoint: None for a node.
    """

    domain: int
    zid: str
    nid: str
    id: str
    kind: Kind
    node: str
    namespace: str = "/"
    enclave: str = "/"
    endpoint: Endpoint | None = None

    @property
    def text(self) -> str:
        """The key on which the token is declared."""
        names = [mangle(it) for it in (self.enclave, self.namespace, self.node)]
        parts = [ADMIN_SPACE, str(self.domain), self.zid, self.nid, self.id, self.kind, *names]
        if self.endpoint:
            end = self.endpoint
            parts += [mangle(end.name), mangle(end.type), mangle(end.hash), qos.encode(end.qos)]
        return "/".join(parts)

    @property
    def gid(self) -> bytes:
        """Identifies the node or endpoint in attachments: XXH3-128 of the token, 16 bytes."""
        return xxhash.xxh3_128_intdigest(self.text.encode()).to_bytes(16, "little")


def parse(text: str) -> Token:
    """Returns the token of a key. Parts after the thirteenth, which newer versions of rmw_zenoh add, are ignored.

    Raises:
        BadToken: the key is none.
    """
    parts = text.split("/")
    try:
        if parts[0] != ADMIN_SPACE or not all(parts) or len(parts) < NODE_PARTS:
            raise ValueError(f"expected {ADMIN_SPACE} and at least {NODE_PARTS - 1} more parts")
        kind = Kind(parts[5])
        if kind is not Kind.NODE and len(parts) < ENDPOINT_PARTS:
            raise ValueError(f"the token of an endpoint has {ENDPOINT_PARTS} parts, this one {len(parts)}")
        if not (parts[1].isascii() and parts[1].isdecimal() and len(parts[1]) < 10):
            raise ValueError(f"{parts[1]!r} is no domain")
        endpoint = None
        if kind is not Kind.NODE:
            name, type_name, type_hash = (demangle(part) for part in parts[9:12])
            endpoint = Endpoint(name, type_name, type_hash, qos.parse(parts[12]))
    except (ValueError, BadQos) as error:
        raise BadToken(f"{text!r} is no token of rmw_zenoh: {error}") from None
    enclave, namespace, node = (demangle(part) for part in parts[6:9])
    zid, nid, number = parts[2:5]
    return Token(int(parts[1]), zid, nid, number, kind, node, namespace, enclave, endpoint)
