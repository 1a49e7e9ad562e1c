"""The 33 bytes beside each sample, query and reply: sequence number, source time and GID."""

import struct
from typing import NamedTuple

FORM = struct.Struct("<qqB16s")
GID_BYTES = 16


class BadAttachment(ValueError):
    """Bytes are no attachment of rmw_zenoh."""


class Attachment(NamedTuple):
    """Metadata that rmw_zenoh sends with a payload."""

    sequence: int  # number of the message at its source, from 1
    source_time: int  # of sending [ns since 1970]
    gid: bytes  # of the source, 16 bytes; a reply has its client's

    @property
    def data(self) -> bytes:
        return FORM.pack(self.sequence, self.source_time, GID_BYTES, self.gid)


def parse(data: bytes | None) -> Attachment:
    """Parses an attachment. Raises BadAttachment: before 2025 rmw_zenoh wrote a name before each value."""
    if data is None:
        raise BadAttachment("a message of rmw_zenoh has an attachment, this one has none")
    if len(data) != FORM.size:
        raise BadAttachment(f"an attachment has {FORM.size} bytes, this one {len(data)}")
    sequence, source_time, length, gid = FORM.unpack(data)
    if length != GID_BYTES or sequence < 0 or source_time < 0:
        raise BadAttachment(f"{data.hex()} is no attachment: a GID of 16 bytes and no negative numbers are expected")
    return Attachment(sequence, source_time, gid)
