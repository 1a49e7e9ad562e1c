"""The 33 bytes beside each sample, query and reply: sequence number, source time and GID."""

import struct
from typing import NamedTuple

FORM = struct.Struct("<qqB16s")
GID_BYTES = 16


class BadAttachment(ValueError):
    """Bytes are no attachment of rmw_zenoh."""


class Attachment(NamedTuple):
    """What rmw_zenoh tells beside a payload.

    Attributes:
        sequence: number of the message of its source, the first is 1.
        source_time: when the source sent it [ns since 1970].
        gid: identifies the source, 16 bytes; a reply has its client's.
    """

    sequence: int
    source_time: int
    gid: bytes

    @property
    def data(self) -> bytes:
        """The attachment's 33 bytes."""
        return FORM.pack(self.sequence, self.source_time, GID_BYTES, self.gid)


def parse(data: bytes | None) -> Attachment:
    """Returns the attachment that has these bytes; None is no attachment at all.

    Raises:
        BadAttachment: there is none, or it has another form: before 2025 rmw_zenoh wrote a name before each value.
    """
    if data is None:
        raise BadAttachment("a message of rmw_zenoh has an attachment, this one has none")
    if len(data) != FORM.size:
        raise BadAttachment(f"an attachment has {FORM.size} bytes, this one {len(data)}")
    sequence, source_time, length, gid = FORM.unpack(data)
    if length != GID_BYTES or sequence < 0 or source_time < 0:
        raise BadAttachment(f"{data.hex()} is no attachment: a GID of 16 bytes and no negative numbers are expected")
    return Attachment(sequence, source_time, gid)
