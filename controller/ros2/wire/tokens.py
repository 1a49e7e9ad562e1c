"""Liveliness tokens, from which ROS 2 learns which nodes and endpoints exist, and their GIDs."""

from enum import StrEnum
from typing import NamedTuple

import xxhash

from hyperbit.controller.ros2.wire.names import demangle, mangle

ADMIN_SPACE = "@ros2_lv"
NODE_PARTS, ENDPOINT_PARTS = 9, 13


class Kind(StrEnum):
    NODE = "NN"
    PUBLISHER = "MP"
    SUBSCRIBER = "MS"
    SERVICE = "SS"
    CLIENT = "SC"


class BadToken(ValueError):
    """A key is no token of rmw_zenoh."""


class EndpointToken(NamedTuple):
    """The fields of an endpoint's token that a node's token lacks."""

    name: str  # absolute name of the topic or service
    type: str  # DDS name, such as std_msgs::msg::dds_::String_
    hash: str  # RIHS01
    qos: str  # quality of service, `Qos.text`


class Token(NamedTuple):
    domain: int  # ROS_DOMAIN_ID
    zid: str  # of the Zenoh session
    nid: str  # the node's number in its session
    id: str  # the node's or endpoint's number in its session
    kind: Kind
    node: str
    namespace: str = "/"  # "/": none
    enclave: str = "/"  # "/": none
    endpoint: EndpointToken | None = None  # None for a node

    @property
    def text(self) -> str:
        """The key on which the token is declared."""
        names = [mangle(it) for it in (self.enclave, self.namespace, self.node)]
        parts = [ADMIN_SPACE, str(self.domain), self.zid, self.nid, self.id, self.kind, *names]
        if self.endpoint:
            end = self.endpoint
            parts += [mangle(end.name), mangle(end.type), mangle(end.hash), end.qos]
        return "/".join(parts)

    @property
    def gid(self) -> bytes:
        """GID in attachments: XXH3-128 of the token, 16 bytes."""
        return xxhash.xxh3_128_intdigest(self.text.encode()).to_bytes(16, "little")


def parse(text: str) -> Token:
    """Parses a key; ignores parts after the thirteenth, of newer versions of rmw_zenoh. Raises BadToken."""
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
            endpoint = EndpointToken(name, type_name, type_hash, parts[12])
    except ValueError as error:
        raise BadToken(f"{text!r} is no token of rmw_zenoh: {error}") from None
    enclave, namespace, node = (demangle(part) for part in parts[6:9])
    zid, nid, number = parts[2:5]
    return Token(int(parts[1]), zid, nid, number, kind, node, namespace, enclave, endpoint)
