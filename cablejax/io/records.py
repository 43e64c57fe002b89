"""Binary records in a file: blocks of equal ones, piece by piece, and records with lists, whose size varies."""

import struct
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from cablejax.io.raw import BadFile, one_short, truncated

PADDING = b"\0 \r\n\t\x1a"


class RecordBlock(NamedTuple):
    """Where the points of a binary file stand.

    Attributes:
        dtype: One record.
        n: How many the header promises.
        start: Bytes before the first.
        last: Whether the file ends with them.
    """

    dtype: np.dtype
    n: int
    start: int
    last: bool

    def held(self, length: int) -> int:
        """How many records a file of so many bytes holds: all of them, or one less, with nothing behind it.

        Raises:
            BadFile: If the file is shorter.
        """
        held, rest = divmod(max(0, length - self.start), self.dtype.itemsize)
        if held >= self.n:
            return self.n
        if rest:  # a record that breaks off: no writer's wrong count
            raise truncated(held, self.n)
        one_short(held, self.n)
        return held

    def rows(self, data: bytes) -> tuple[np.ndarray, tuple[str, ...]]:
        """All records of a file's content `[n]`, and what is to be said of them.

        Raises:
            BadFile: If it is too short, or goes on with more than padding.
        """
        held = self.held(len(data))
        end = self.start + held * self.dtype.itemsize
        if self.last and len(data) - end >= self.dtype.itemsize and data[end:].strip(PADDING):
            raise self._too_long(len(data) - end)
        notes = one_short(held, self.n) if held < self.n else ()
        return np.frombuffer(data, self.dtype, held, self.start), notes

    def read(self, stream: Any, size: int) -> Iterator[np.ndarray]:
        """Records from a stream, `size` at a time; one less than promised where the last is missing.

        Raises:
            BadFile: If the stream ends too soon, or goes on with more than padding.
        """
        stream.seek(self.start)
        done = 0
        while done < self.n or done == 0:
            count = min(size, self.n - done)
            data = stream.read(count * self.dtype.itemsize)
            held = len(data) // self.dtype.itemsize
            if held < count:
                self.held(self.start + done * self.dtype.itemsize + len(data))
            yield np.frombuffer(data, self.dtype, held)
            done += count
            if held < count or not self.n:
                break
        left, padding = 0, True
        while self.last and (data := stream.read(2**20)):
            left, padding = left + len(data), padding and not data.strip(PADDING)
            if left >= self.dtype.itemsize and not padding:
                raise self._too_long(left)

    def _too_long(self, left: int) -> BadFile:
        return BadFile(f"holds {left:,} bytes more than the {self.n:,} points of its header")


def varying_records(
    data: bytes, start: int, n: int, fields: Sequence[tuple[str, str, str | None]], *, what: str
) -> tuple[dict[str, np.ndarray], int]:
    """Walk through records with lists, which say their length before each.

    Args:
        data: The file.
        start: Where the first record begins.
        n: How many there are.
        fields: Name, NumPy type, and for a list the type of its length, else None.
        what: Name of the records, for messages.

    Returns:
        The columns `[n]` that are no lists, by name (of equal names the first), and where the last record ends.

    Raises:
        BadFile: If the data ends before.
    """
    if n > len(data) - start:
        raise BadFile(
            f"is truncated: its header promises {n:,} records of {what}, {len(data) - start:,} bytes are left"
        )
    steps = _steps(fields)
    found: list[tuple] = []
    at = start
    try:
        for _ in range(n):
            values: tuple = ()
            for scalars, size in steps:
                values += scalars.unpack_from(data, at)
                at += scalars.size
                if size:
                    length = values[-1]
                    values = values[:-1]
                    if length < 0:
                        raise BadFile(f"is damaged: a list of {what} has the length {length}")
                    at += length * size
            if at > len(data):
                raise struct.error
            found.append(values)
    except struct.error:
        raise BadFile(f"is truncated: its header promises {n:,} records of {what}, {len(found):,} are there") from None
    names = [(name, kind) for name, kind, length in fields if length is None]
    columns = zip(*found, strict=True) if found else [()] * len(names)
    named = [(name, np.array(column, kind)) for (name, kind), column in zip(names, columns, strict=True)]
    return dict(reversed(named)), at


def _steps(fields: Sequence[tuple[str, str, str | None]]) -> list[tuple[struct.Struct, int]]:
    """Stretches of scalars with the length of the list behind them, and the size of that list's entries."""
    order = fields[0][1][0] if fields else "<"
    steps, codes = [], ""
    for _, kind, length in fields:
        codes += np.dtype(length or kind).newbyteorder("=").char
        if length is not None:
            steps.append((struct.Struct(order + codes), np.dtype(kind).itemsize))
            codes = ""
    return [*steps, (struct.Struct(order + codes), 0)]
