"""Reads the messages of one mcap file from front to back, also of a cut or damaged one.

The mcap library's readers give up at the first fault and drop the whole messages of a cut chunk.
Here the framing (kind, length, content) is followed by hand, with every length checked against
what is there before anything is read, so that memory stays bounded whatever the file says.

References
----------
MCAP format specification, version 0, https://mcap.dev/spec
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, Protocol, cast

import zstandard
from lz4.frame import LZ4FrameDecompressor  # type: ignore[import-untyped]
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Schema, Statistics

from momrec_ros.errors import BagError

__all__ = ["Loss", "McapScan", "RawMessage"]

MAGIC = b"\x89MCAP0\r\n"
RECORD_HEAD = struct.Struct("<BQ")
MESSAGE_HEAD = struct.Struct("<HIQQ")
CHUNK_HEAD = struct.Struct("<QQQII")
FOOTER = struct.Struct("<BQQQI")
CHUNK_INDEX_OFFSET = struct.Struct("<16xQ")
FIRST_PRIVATE_OPCODE = 0x80
BLOCK = 1 << 16  # bytes read or decompressed at a time
LARGEST_DEFINITION = 1 << 20  # bytes of a schema or channel; the longest of ROS take 50 kB
LARGEST_MESSAGE = 1 << 26  # bytes; 20 times a view of a million points is refused anyway
LARGEST_CHUNK = 1 << 28  # bytes of a compressed chunk; recorders write 1 to 10 MB
LONGEST_COMPRESSION_NAME = 32
LONGEST_NAME = 1024  # characters of a topic or type
WINDOW_LOG = 27  # zstd's own limit for streams, 128 MB


@dataclass(frozen=True)
class Loss:
    """Something of a file that could not be read.

    Attributes
    ----------
    size : int
        Bytes of the file that are there but of no use; what is missing cannot be counted.
    reason : str
        Where and why.
    """

    size: int
    reason: str


@dataclass(frozen=True)
class RawMessage:
    """A message as it was recorded.

    Attributes
    ----------
    topic : str
        Its topic.
    type_name : str
        Such as ``"geometry_msgs/msg/PoseStamped"``.
    log_time : int
        When it was recorded, nanoseconds.
    data : bytes
        The serialised message.
    """

    topic: str
    type_name: str
    log_time: int
    data: bytes


class _FaultError(Exception):
    """What ends the reading of a file or a chunk."""


@dataclass(frozen=True)
class _ChunkHead:
    """What a chunk says about itself; sizes in bytes."""

    compression: str
    size: int
    uncompressed_size: int
    crc: int


class _Readable(Protocol):
    def read(self, size: int, /) -> bytes: ...


class _Region:
    """The bytes of a stream up to an end."""

    def __init__(self, stream: BinaryIO, end: int) -> None:
        self._stream = stream
        self._end = end

    def read(self, size: int = -1, /) -> bytes:
        left = max(self._end - self._stream.tell(), 0)
        return self._stream.read(left if size < 0 else min(size, left))


class McapScan:
    """Iterates over the wanted messages of an mcap file in the order of the file.

    Parameters
    ----------
    path : Path
        The file.
    wanted : callable
        Told topic, type name and encoding of a channel; only messages of channels for which it
        returns True are read.

    Attributes
    ----------
    losses : list of Loss
        Grows while iterating; complete after it.
    position : int
        How far the file has been read, bytes.
    size : int
        Of the file, bytes.

    Raises
    ------
    BagError
        If the file cannot be opened or is no mcap file.
    """

    def __init__(self, path: Path, wanted: Callable[[str, str, str], bool]) -> None:
        self._path = path
        self._wanted = wanted
        self._schemas: dict[int, str] = {}
        self._channels: dict[int, tuple[str, str, bool]] = {}
        self._messages = 0
        self._expected_messages: int | None = None
        self._is_complete = False
        self._at = 0  # where the record being read begins
        self._used = 0  # up to where all is read or accounted for
        self.losses: list[Loss] = []
        self.position = 0
        try:
            self.size = path.stat().st_size
            with path.open("rb") as stream:
                magic = stream.read(len(MAGIC))
        except OSError as error:
            raise BagError(f"Expected a readable mcap file, got {path}: {error}") from error
        if magic != MAGIC:
            raise BagError(
                f"Expected an mcap file, got {path} of {self.size} bytes beginning {magic!r}"
            )

    def __iter__(self) -> Iterator[RawMessage]:
        try:
            with self._path.open("rb") as stream:
                stream.seek(len(MAGIC))
                yield from self._top_level(stream)
        except OSError as error:
            self._lose(self.size - self.position, f"reading failed: {error}")
        self.position = self.size

    def _lose(self, size: int, reason: str) -> None:
        self.losses.append(Loss(size, f"{self._path.name}: {reason}"))

    def _top_level(self, stream: BinaryIO) -> Iterator[RawMessage]:
        """Read record after record; after a fault go on at the next chunk that the index names."""
        start: int | None = len(MAGIC)
        while start is not None:
            stream.seek(start)
            self._is_complete = False
            try:
                yield from self._records(stream)
                start = None
            except _FaultError as fault:
                later = [at for at in _chunk_offsets(stream, self.size) if at > self._at]
                start = min(later, default=None)
                end = self.size if start is None else start
                self._lose(max(end - self._used, 0), str(fault))

    def _records(self, stream: BinaryIO) -> Iterator[RawMessage]:
        while not self._is_complete:
            self._at = self._used = self.position = stream.tell()
            opcode, length = _record_head(stream, self.size)
            end = self._at + RECORD_HEAD.size + length
            if opcode == Opcode.CHUNK:
                yield from self._chunk(stream, end)
                self._used = min(end, self.size)  # what a cut chunk held is accounted for
            _check_end(end, self.size, opcode, self._at)
            if opcode != Opcode.CHUNK:
                yield from self._record(stream, opcode, length)
            stream.seek(end)
        self._check_tail(stream)

    def _check_tail(self, stream: BinaryIO) -> None:
        tail = stream.read(len(MAGIC) + 1)
        if tail != MAGIC:
            raise _FaultError(f"the file does not end with its mark but with {tail!r}")
        if self._expected_messages not in (None, self._messages):
            raise _FaultError(
                f"{self._messages} messages found where the file's statistics say "
                f"{self._expected_messages}"
            )

    def _record(self, stream: BinaryIO, opcode: int, length: int) -> Iterator[RawMessage]:
        if opcode == Opcode.MESSAGE:
            yield from self._message(stream, length)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            self._definition(stream, opcode, length)
        elif opcode == Opcode.STATISTICS:
            self._statistics(stream, length)
        elif opcode == Opcode.FOOTER:
            self._is_complete = True
        elif not Opcode.HEADER <= opcode <= Opcode.DATA_END and opcode < FIRST_PRIVATE_OPCODE:
            self._lose(length, f"a record of unknown kind {opcode:#04x} at byte {self._at}")

    def _statistics(self, stream: BinaryIO, length: int) -> None:
        content = stream.read(min(length, LARGEST_DEFINITION))
        try:
            statistics = Statistics.read(ReadDataStream(BytesIO(content)))
        except (McapError, struct.error) as error:
            self._lose(length, f"statistics that cannot be read at byte {self._at} ({error})")
        else:
            self._expected_messages = statistics.message_count

    def _definition(self, stream: BinaryIO, opcode: int, length: int) -> None:
        try:
            content = ReadDataStream(BytesIO(_read_definition(stream, length)))
            if opcode == Opcode.SCHEMA:
                self._add_schema(Schema.read(content))
            else:
                self._add_channel(Channel.read(content))
        except (McapError, struct.error, UnicodeDecodeError, _FaultError) as error:
            name = Opcode(opcode).name.lower()
            self._lose(length, f"a {name} that cannot be read near byte {self._at} ({error})")

    def _add_schema(self, schema: Schema) -> None:
        if len(schema.name) > LONGEST_NAME:
            raise _FaultError(f"a name of {len(schema.name)} characters")
        self._schemas[schema.id] = schema.name

    def _add_channel(self, channel: Channel) -> None:
        if len(channel.topic) > LONGEST_NAME:
            raise _FaultError(f"a topic of {len(channel.topic)} characters")
        type_name = self._schemas.get(channel.schema_id, "")
        known = self._channels.get(channel.id)
        if known is None or known[:2] != (channel.topic, type_name):
            wanted = self._wanted(channel.topic, type_name, channel.message_encoding)
            self._channels[channel.id] = channel.topic, type_name, wanted

    def _message(self, stream: BinaryIO, length: int) -> Iterator[RawMessage]:
        if length < MESSAGE_HEAD.size:
            self._lose(length, f"a message of {length} bytes near byte {self._at}")
            return
        channel_id, _, log_time, _ = MESSAGE_HEAD.unpack(stream.read(MESSAGE_HEAD.size))
        self._messages += 1
        if channel_id not in self._channels:
            self._lose(length, f"a message of an unknown channel {channel_id} near byte {self._at}")
            return
        topic, type_name, wanted = self._channels[channel_id]
        if not wanted:
            return
        if length > LARGEST_MESSAGE:
            self._lose(length, f"a message of {length} bytes on {topic}, above {LARGEST_MESSAGE}")
            return
        yield RawMessage(topic, type_name, log_time, stream.read(length - MESSAGE_HEAD.size))

    def _chunk(self, stream: BinaryIO, record_end: int) -> Iterator[RawMessage]:
        """Read the messages of a chunk, of a cut one those before the end of the file."""
        what = f"the chunk at byte {self._at}"
        end = min(record_end, self.size)
        try:
            head = _chunk_head(stream, end)
        except _FaultError as fault:
            self._lose(end - self._at, f"{what}: {fault}")
            return
        start = stream.tell()
        is_whole = start + head.size <= end
        if not is_whole and record_end <= self.size:
            self._lose(0, f"{what} says that it reaches beyond its end")
        region_end = min(start + head.size, end)
        crc = head.crc if is_whole else 0
        if head.compression == "":
            for message in self._plain_chunk(stream, region_end, crc, what):
                self.position = stream.tell()
                yield message
        elif head.uncompressed_size > LARGEST_CHUNK:
            reason = f"{what} unfolds to {head.uncompressed_size} bytes, above {LARGEST_CHUNK}"
            self._lose(region_end - start, reason)
        else:
            region = _Region(stream, region_end)
            content, defect = _decompress(region, head.compression, head.uncompressed_size)
            if defect:
                self._lose(0, f"{what} is cut or damaged ({defect})")
            inner = BytesIO(content)
            yield from self._plain_chunk(inner, len(content), 0 if defect else crc, what)

    def _plain_chunk(self, stream: BinaryIO, end: int, crc: int, what: str) -> Iterator[RawMessage]:
        """Read records up to ``end``; a chunk's checksum of 0 is none."""
        if crc and _checksum(stream, end) != crc:
            self._lose(
                0, f"{what} does not fit its checksum: some of the messages read are damaged"
            )
        start = stream.tell()
        try:
            while (start := stream.tell()) < end:
                opcode, length = _record_head(stream, end)
                record_end = start + RECORD_HEAD.size + length
                _check_end(record_end, end, opcode, start)
                _check_place(opcode)
                yield from self._record(stream, opcode, length)
                stream.seek(record_end)
        except _FaultError as fault:
            self._lose(end - start, f"{what}: {fault}")


def _chunk_offsets(stream: BinaryIO, size: int) -> list[int]:
    """Return where the chunks begin by the index at the file's end, if there is one."""
    offsets = []
    stream.seek(max(size - FOOTER.size - len(MAGIC), 0))
    footer = stream.read(FOOTER.size)
    if len(footer) < FOOTER.size or stream.read() != MAGIC:
        return []
    opcode, _, at, _, _ = FOOTER.unpack(footer)
    with suppress(_FaultError, struct.error):
        while opcode in range(Opcode.HEADER, Opcode.DATA_END) and 0 < at < size:
            stream.seek(at)
            opcode, length = _record_head(stream, size)
            if opcode == Opcode.CHUNK_INDEX:
                offsets.append(CHUNK_INDEX_OFFSET.unpack(stream.read(CHUNK_INDEX_OFFSET.size))[0])
            if opcode == Opcode.FOOTER:
                break
            at += RECORD_HEAD.size + length
    return [offset for offset in offsets if offset < size]


def _chunk_head(stream: BinaryIO, end: int) -> _ChunkHead:
    """Read what precedes a chunk's records."""
    head = stream.read(min(CHUNK_HEAD.size, end - stream.tell()))
    if len(head) < CHUNK_HEAD.size:
        raise _FaultError(f"it ends at byte {end}, within its head")
    _, _, uncompressed_size, crc, name_length = CHUNK_HEAD.unpack(head)
    if name_length > LONGEST_COMPRESSION_NAME:
        raise _FaultError(f"the name of its compression is {name_length} bytes long")
    tail = stream.read(min(name_length + 8, end - stream.tell()))
    if len(tail) < name_length + 8:
        raise _FaultError(f"it ends at byte {end}, within its head")
    compression = tail[:name_length].decode(errors="replace")
    (size,) = struct.unpack("<Q", tail[name_length:])
    return _ChunkHead(compression, size, uncompressed_size, crc)


def _read_definition(stream: BinaryIO, length: int) -> bytes:
    if length > LARGEST_DEFINITION:
        raise _FaultError(f"{length} bytes long")
    return stream.read(length)


def _record_head(stream: BinaryIO, end: int) -> tuple[int, int]:
    start = stream.tell()
    head = stream.read(min(RECORD_HEAD.size, end - start))
    if len(head) < RECORD_HEAD.size:
        raise _FaultError(f"it ends at byte {end} where a record was expected")
    opcode, length = RECORD_HEAD.unpack(head)
    return opcode, length


def _check_end(record_end: int, end: int, opcode: int, start: int) -> None:
    if record_end > end:
        raise _FaultError(
            f"it ends at byte {end}, within the record of kind {opcode:#04x} at byte {start} "
            f"that should reach to {record_end}"
        )


def _check_place(opcode: int) -> None:
    is_private = opcode >= FIRST_PRIVATE_OPCODE
    if not is_private and opcode not in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.MESSAGE):
        raise _FaultError(f"a record of kind {opcode:#04x} has no place in a chunk")


def _checksum(stream: BinaryIO, end: int) -> int:
    start = stream.tell()
    region = _Region(stream, end)
    crc = 0
    while block := region.read(BLOCK):
        crc = zlib.crc32(block, crc)
    stream.seek(start)
    return crc


def _decompress(source: _Region, compression: str, size: int) -> tuple[bytes, str]:
    """Return the first ``size`` bytes, or what there is of them and what is wrong with the rest."""
    content = bytearray()
    try:
        stream = _open_compressed(source, compression)
        while len(content) < size and (block := stream.read(min(BLOCK, size - len(content)))):
            content += block
    except (zstandard.ZstdError, RuntimeError, EOFError, _FaultError) as error:
        return bytes(content), str(error)
    missing = size - len(content)
    return bytes(content), f"{missing} bytes are missing" if missing else ""


def _open_compressed(source: _Region, compression: str) -> _Readable:
    if compression == "zstd":
        decompressor = zstandard.ZstdDecompressor(max_window_size=1 << WINDOW_LOG)
        return decompressor.stream_reader(cast("BinaryIO", source), read_size=BLOCK)
    if compression == "lz4":
        return _Lz4Stream(source)
    raise _FaultError(f"compression zstd, lz4 or none was expected, got {compression[:32]!r}")


class _Lz4Stream:
    """Decompresses no more at a time than is asked for."""

    def __init__(self, source: _Region) -> None:
        self._source = source
        self._decompressor = LZ4FrameDecompressor()

    def read(self, size: int, /) -> bytes:
        decompressor = self._decompressor
        while not decompressor.eof:
            packed = self._source.read(BLOCK) if decompressor.needs_input else b""
            block: bytes = decompressor.decompress(packed, max_length=size)
            if block or (decompressor.needs_input and not packed):
                return block
        return b""
