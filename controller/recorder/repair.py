"""Repairs recordings that are incomplete after a kill or a power failure: flushed data is kept, the rest cut off."""

import os
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import zstandard
from mcap.exceptions import McapError
from mcap.records import Attachment, Channel, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import CRCValidationError, StreamReader
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer

from hyperbit.controller.host.files import open_file
from hyperbit.controller.recorder.recording import LIBRARY

MOST = 1 << 30  # bytes of one record; a greater length is damage
HEAD = len(MCAP0_MAGIC)
# Exceptions of mcap and its libraries on damaged data.
DAMAGE = (
    McapError,
    CRCValidationError,
    EOFError,
    ValueError,
    KeyError,
    struct.error,
    zlib.error,
    zstandard.ZstdError,
    RuntimeError,
    MemoryError,
)


def unfinished(path: Path) -> bool:
    """Returns whether a file begins as an MCAP file, but has no end."""
    with open_file(path, None) as file:
        if not MCAP0_MAGIC.startswith(file.read(HEAD)):
            return False
        if os.fstat(file.fileno()).st_size < 2 * HEAD:
            return True
        file.seek(-HEAD, os.SEEK_END)
        return file.read() != MCAP0_MAGIC


def repair(path: Path) -> int | None:
    """Completes an incomplete file from its whole records; deletes a file without records.

    Returns the number of messages in the completed file; None if it was deleted.

    The completed file replaces the incomplete one atomically: a kill meanwhile leaves the incomplete file.

    Raises:
        OSError: the file cannot be read or written.
    """
    temporary = path.with_suffix(".repairing")
    try:
        with open_file(path, None) as damaged, temporary.open("wb") as completed:
            count, records = rewrite(damaged, completed)
            completed.flush()
            os.fsync(completed.fileno())
        if records == 0:
            path.unlink()
            return None
        os.replace(temporary, path)
    finally:
        temporary.unlink(missing_ok=True)
    return count


def rewrite(damaged: IO[bytes], completed: IO[Any]) -> tuple[int, int]:
    """Writes all whole records of a stream as a complete file; returns the numbers of messages and records."""
    writer = Writer(completed, compression=CompressionType.ZSTD)
    writer.start(profile="", library=LIBRARY)
    schemas: dict[int, int] = {0: 0}
    channels: dict[int, int] = {}
    messages = records = 0
    for record in whole_records(damaged):
        records += 1
        match record:
            case Schema():
                if record.id not in schemas:
                    schemas[record.id] = writer.register_schema(record.name, record.encoding, record.data)
            case Channel():
                if record.id not in channels and record.schema_id in schemas:
                    channels[record.id] = writer.register_channel(
                        record.topic, record.message_encoding, schemas[record.schema_id], record.metadata
                    )
            case Message():
                if record.channel_id in channels:
                    channel = channels[record.channel_id]
                    writer.add_message(channel, record.log_time, record.data, record.publish_time, record.sequence)
                    messages += 1
            case Metadata():
                writer.add_metadata(record.name, record.metadata)
            case Attachment():
                times = record.create_time, record.log_time
                writer.add_attachment(*times, record.name, record.media_type, record.data)
            case _:
                records -= 1
    writer.finish()  # type: ignore[no-untyped-call]
    return messages, records


def whole_records(stream: IO[bytes]) -> Iterator[McapRecord]:
    """Yields the records of a stream before the first incomplete or damaged one."""
    reader = StreamReader(stream, validate_crcs=True, record_size_limit=MOST)
    try:
        yield from reader.records
    except DAMAGE:
        return
