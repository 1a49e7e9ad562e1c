"""Repairs recordings that are incomplete after a kill or a power failure: flushed data is kept, the rest cut off."""

import contextlib
import os
import struct
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import IO, Any, NamedTuple

from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, McapRecord, Message, Metadata, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer

from hyperbit.controller.host.files import open_file, set_aside
from hyperbit.controller.recorder.recording import LIBRARY

MOST = 1 << 26  # bytes of one record, compressed or not; a greater length is damage
HEAD = len(MCAP0_MAGIC)
RECORD = struct.Struct("<BQ")  # opcode and length before each record
READ = (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE, Opcode.CHUNK, Opcode.METADATA, Opcode.ATTACHMENT)


class BadRecording(Exception):
    """A file is no recording of an arm; the text says why."""


@contextlib.contextmanager
def guarded(path: Path, *others: type[Exception]) -> Iterator[None]:
    """Turns each exception of this context, which reads a recording, into BadRecording, except those of `others`.

    mcap and its libraries raise nearly any exception on damaged data, and so does what reads a message of another form.
    """
    try:
        yield
    except OSError as error:
        raise BadRecording(f"{path}: cannot be read: {error.strerror or error}") from None
    except Exception as error:
        if isinstance(error, (BadRecording, *others)):
            raise
        raise BadRecording(f"{path}: no MCAP file, or damaged: {type(error).__name__}: {error}") from error


class Rewritten(NamedTuple):
    """What was written of an incomplete file: messages, all records, and why something else than the end is lost."""

    messages: int
    records: int
    damage: str


def unfinished(path: Path) -> bool:
    """Returns whether a file begins as an MCAP file, but has no end."""
    with open_file(path, None) as file:
        if not MCAP0_MAGIC.startswith(file.read(HEAD)):
            return False
        if os.fstat(file.fileno()).st_size < 2 * HEAD:
            return True
        file.seek(-HEAD, os.SEEK_END)
        return file.read() != MCAP0_MAGIC


def repair(path: Path, kind: str | None = None) -> Rewritten:
    """Completes an incomplete file from its whole records; deletes a file without records.

    A damaged file is set aside, as one of its `kind` (see `set_aside`); what can be read of it takes its place. The
    completed file replaces the incomplete one atomically: a kill meanwhile leaves the incomplete file.

    Raises:
        OSError: the file cannot be read or written.
    """
    temporary = path.with_suffix(".repairing")
    try:
        with open_file(path, None) as damaged, temporary.open("wb") as completed:
            found = rewrite(damaged, completed)
            completed.flush()
            os.fsync(completed.fileno())
        then = f"{found.messages} messages of it can be read"
        if found.damage and set_aside(path, found.damage, then, kind=kind) is None:
            return found
        if found.messages or (found.records and not found.damage):
            os.replace(temporary, path)
        else:
            path.unlink(missing_ok=True)
    finally:
        temporary.unlink(missing_ok=True)
    return found


def rewrite(damaged: IO[bytes], completed: IO[Any]) -> Rewritten:
    """Writes all whole records of a stream as a complete file. A damaged record is left out."""
    writer = Writer(completed, compression=CompressionType.ZSTD)
    writer.start(profile="", library=LIBRARY)
    schemas: dict[int, int] = {0: 0}
    channels: dict[int, int] = {}
    messages = records = 0
    damage = ""
    for record in records_of(damaged):
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
            case Exception():
                damage = damage or f"{type(record).__name__}: {record}"
                continue
        records += 1
    writer.finish()  # type: ignore[no-untyped-call]
    return Rewritten(messages, records, damage)


def records_of(stream: IO[bytes]) -> Iterator[McapRecord | Exception]:
    """Yields the records of a stream before the cut at its end, and in place of each damaged one its exception."""
    stream.seek(HEAD)
    while len(head := stream.read(RECORD.size)) == RECORD.size:
        opcode, length = RECORD.unpack(head)
        if length > MOST:
            yield McapError(f"a record of {length} bytes; all after it is lost")
            return
        if len(body := stream.read(length)) < length:
            return
        if opcode in READ:
            try:
                yield from parsed(head + body)
            except Exception as error:  # mcap and its libraries raise nearly any
                yield error


def parsed(data: bytes) -> list[McapRecord]:
    """Returns the record in some bytes, of a chunk all records in it; raises nearly any exception if it is damaged."""
    record = next(StreamReader(BytesIO(data), skip_magic=True, emit_chunks=True).records)
    if not isinstance(record, Chunk):
        return [record]
    if record.uncompressed_size > MOST:
        raise McapError(f"a chunk of {record.uncompressed_size} bytes")
    return breakup_chunk(record, validate_crc=True)
