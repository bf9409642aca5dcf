"""Common Data Representation, the serialised form of ROS 2 messages: its primitives.

ROS 2 writes plain CDR (XCDR1): four bytes of encapsulation header, then the fields in their order,
each primitive aligned to its size, counted from the byte after the header. Arrays of numbers are
read and written as numpy views, never number by number.

References
----------
OMG DDS-XTypes 1.3, section 7.4.1 (XCDR version 1); OMG DDSI-RTPS 2.3, section 10 (encapsulation).
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from momrec_ros.errors import CdrError

__all__ = ["CdrReader", "CdrWriter"]

HEADER_SIZE = 4
HEADER_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
BYTE_ORDERS = {b"\x00\x00": ">", b"\x00\x01": "<"}  # representation identifiers of plain CDR
TRANSPORT_ALIGNMENT = 4  # DDS may round a payload up to it; what the extra bytes hold is undefined
PADDING = b"\x00"


class CdrReader:
    """Reads primitives one after the other and never beyond the buffer.

    Parameters
    ----------
    data : bytes-like
        One serialised message with its encapsulation header, of either byte order.

    Raises
    ------
    CdrError
        If the header is missing or names another representation than plain CDR.
    """

    def __init__(self, data: bytes | bytearray | memoryview) -> None:
        header = bytes(data[:HEADER_SIZE])
        if len(header) < HEADER_SIZE:
            raise CdrError(f"Expected {HEADER_SIZE} bytes of CDR header, got {len(header)}")
        order = BYTE_ORDERS.get(header[:2])
        if order is None:
            raise CdrError(f"Expected a plain CDR header (00 00 or 00 01), got {header.hex(' ')}")
        self._order = order
        self._data = memoryview(data)[HEADER_SIZE:]
        self._position = 0

    @property
    def remaining(self) -> int:
        """How many bytes are left to read."""
        return len(self._data) - self._position

    def _take(self, size: int, alignment: int, what: str) -> int:
        start = self._position + -self._position % alignment
        if size > len(self._data) - start:
            raise CdrError(
                f"Expected {size} bytes of {what} at byte {start + HEADER_SIZE}, got "
                f"{max(len(self._data) - start, 0)} before the end of the message"
            )
        self._position = start + size
        return start

    def numbers(self, form: str, alignment: int, what: str) -> tuple[Any, ...]:
        """Read primitives that follow each other without gaps.

        Parameters
        ----------
        form : str
            Their `struct` format without byte order.
        alignment : int
            Size of the first primitive in bytes; no later one may be larger.
        what : str
            Name of the field, for the error.

        Raises
        ------
        CdrError
            If the message ends before.
        """
        form = self._order + form
        start = self._take(struct.calcsize(form), alignment, what)
        return struct.unpack_from(form, self._data, start)

    def count(self, item_size: int, what: str) -> int:
        """Read the length of a sequence whose items take at least ``item_size`` bytes each.

        Raises
        ------
        CdrError
            If so many items cannot follow in this message.
        """
        (count,) = self.numbers("I", 4, f"the length of {what}")
        if count * item_size > self.remaining:
            raise CdrError(
                f"Expected {what} within the {self.remaining} bytes left, got a length of {count} "
                f"with at least {item_size} bytes each"
            )
        return int(count)

    def boolean(self, what: str) -> bool:
        """Read a bool, which must be 0 or 1."""
        (value,) = self.numbers("B", 1, what)
        if value > 1:
            raise CdrError(f"Expected 0 or 1 for {what}, got {value}")
        return bool(value)

    def string(self, what: str) -> str:
        """Read a UTF-8 string with its terminating NUL."""
        size = self.count(1, what)
        if size == 0:
            return ""  # some writers leave out even the terminator
        start = self._take(size, 1, what)
        content = bytes(self._data[start : start + size])
        if content.find(0) != size - 1:
            raise CdrError(f"Expected one NUL, at the end of {what}, got {content[-40:]!r}")
        try:
            return content[:-1].decode()
        except UnicodeDecodeError as error:
            raise CdrError(f"Expected UTF-8 in {what}, got {content[:40]!r}") from error

    def octets(self, what: str) -> bytes:
        """Read a sequence of bytes."""
        size = self.count(1, what)
        start = self._take(size, 1, what)
        return bytes(self._data[start : start + size])

    def array(self, number: str, columns: int, what: str) -> NDArray[Any]:
        """Read a sequence of equal rows of numbers.

        Parameters
        ----------
        number : str
            numpy's code of one number without byte order, such as ``"f8"``.
        columns : int
            Numbers in a row.
        what : str
            Name of the field, for the error.

        Returns
        -------
        rows : array, shape (n, columns)
            A read-only view of the message where its byte order is the machine's.

        Raises
        ------
        CdrError
            If the message ends before.
        """
        dtype = np.dtype(self._order + number)
        count = self.count(dtype.itemsize * columns, what)
        if count == 0:
            return np.empty((0, columns), dtype.newbyteorder("="))
        start = self._take(count * columns * dtype.itemsize, dtype.itemsize, what)
        flat = np.frombuffer(self._data, dtype, count * columns, start)
        return flat.reshape(count, columns).astype(dtype.newbyteorder("="), copy=False)

    def finish(self) -> None:
        """Check that nothing is left but what a transport may add to a multiple of 4 bytes.

        Raises
        ------
        CdrError
            If the message is longer than its fields.
        """
        rounded = -self._position % TRANSPORT_ALIGNMENT
        if self.remaining not in (0, rounded):
            raise CdrError(
                f"Expected the message to end at byte {self._position + HEADER_SIZE}, got "
                f"{self.remaining} bytes more"
            )


class CdrWriter:
    """Writes primitives one after the other, little endian, as ROS 2 does."""

    def __init__(self) -> None:
        self._parts: list[bytes | memoryview] = [HEADER_LITTLE_ENDIAN]
        self._position = 0

    def _append(self, content: bytes | memoryview, alignment: int) -> None:
        gap = -self._position % alignment
        if gap:
            self._parts.append(PADDING * gap)
        self._parts.append(content)
        self._position += gap + len(content)

    def numbers(self, form: str, alignment: int, *values: float) -> None:
        """Write primitives that follow each other without gaps; see `CdrReader.numbers`.

        Raises
        ------
        CdrError
            If a value does not fit its type.
        """
        try:
            content = struct.pack("<" + form, *values)
        except (struct.error, OverflowError) as error:
            raise CdrError(f"Expected values that fit {form!r} ({error}), got {values}") from error
        self._append(content, alignment)

    def count(self, count: int) -> None:
        """Write the length of a sequence."""
        self.numbers("I", 4, count)

    def string(self, text: str) -> None:
        """Write a string as UTF-8 with its terminating NUL.

        Raises
        ------
        CdrError
            If it holds a NUL or a lone surrogate.
        """
        try:
            content = text.encode()
        except UnicodeEncodeError as error:
            raise CdrError(f"Expected text that UTF-8 can hold, got {text!r:.80}") from error
        if 0 in content:
            raise CdrError(f"Expected text without NUL, got {text!r:.80}")
        self._append(struct.pack("<I", len(content) + 1) + content + b"\x00", 4)

    def octets(self, content: bytes) -> None:
        """Write a sequence of bytes."""
        self.count(len(content))
        self._append(bytes(content), 1)

    def array(self, number: str, columns: int, rows: ArrayLike | Sequence[Any]) -> None:
        """Write a sequence of equal rows of numbers, shape (n, columns); see `CdrReader.array`.

        Raises
        ------
        CdrError
            If the rows have another shape, or a value does not fit the type.
        """
        given = np.asarray(rows)
        if given.size == 0:
            self.count(0)
            return
        if given.ndim != 2 or given.shape[1] != columns:
            raise CdrError(f"Expected rows of shape (n, {columns}), got shape {given.shape}")
        dtype = np.dtype("<" + number)
        self.count(len(given))
        self._append(_number_bytes(given, dtype), dtype.itemsize)

    def fields(self, content: bytes, alignment: int) -> None:
        """Write what a writer of its own wrote, which `content` returned.

        Parameters
        ----------
        content : bytes
            Fields of which none is aligned to more than ``alignment``.
        alignment : int
            4 or 8 bytes.
        """
        self._append(content, alignment)

    def content(self) -> bytes:
        """Return the fields so far, without the encapsulation header."""
        return b"".join(self._parts[1:])

    def finish(self) -> bytes:
        """Return the serialised message."""
        return b"".join(self._parts)


def _number_bytes(values: NDArray[Any], dtype: np.dtype[Any]) -> memoryview:
    """Return numbers as a dtype's bytes, those of the array itself where they are the same."""
    if values.dtype != dtype:
        if dtype.kind in "iu":
            _check_integers(values, dtype)
        with np.errstate(over="ignore"):
            values = values.astype(dtype)
    return np.ascontiguousarray(values).data.cast("B")


def _check_integers(values: NDArray[Any], dtype: np.dtype[Any]) -> None:
    limits = np.iinfo(dtype)
    if values.dtype.kind not in "iu" or values.min() < limits.min or values.max() > limits.max:
        raise CdrError(
            f"Expected whole numbers from {limits.min} to {limits.max}, got {values.dtype} from "
            f"{values.min()} to {values.max()}"
        )
