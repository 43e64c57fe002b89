"""A block of equal binary records in a file: how long it must be, and its rows piece by piece."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from cablejax.io.raw import BadFile


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

    def check_length(self, length: int) -> None:
        """Compare with the length of the file in bytes.

        Raises:
            BadFile: If the file is too short, or too long by a record or more.
        """
        left = length - self.start - self.n * self.dtype.itemsize
        if left < 0:
            held = max(0, length - self.start) // self.dtype.itemsize
            raise BadFile(f"is truncated: its header promises {self.n:,} points, {held:,} are there")
        if self.last and left >= self.dtype.itemsize:
            raise BadFile(f"holds {left:,} bytes more than the {self.n:,} points of its header")

    def rows(self, data: bytes) -> np.ndarray:
        """All records of a file's content `[n]`.

        Raises:
            BadFile: If it is too short or too long.
        """
        self.check_length(len(data))
        return np.frombuffer(data, self.dtype, self.n, self.start)

    def read(self, stream: Any, size: int) -> Iterator[np.ndarray]:
        """Records from a stream, `size` at a time.

        Raises:
            BadFile: If the stream ends too soon, or goes on.
        """
        stream.seek(self.start)
        for done in range(0, max(self.n, 1), size):
            count = min(size, self.n - done)
            data = stream.read(count * self.dtype.itemsize)
            held = len(data) // self.dtype.itemsize
            if held < count:
                raise BadFile(f"is truncated: its header promises {self.n:,} points, {done + held:,} are there")
            yield np.frombuffer(data, self.dtype, count)
        if self.last and len(stream.read(self.dtype.itemsize)) == self.dtype.itemsize:
            raise BadFile(f"holds more than the {self.n:,} points of its header")
