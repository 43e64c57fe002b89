"""Damage files at random, reproducibly: what `fuzz_readers.py` feeds to the readers."""

import re
from collections.abc import Callable, Iterator

import numpy as np

E57_PAGE = 1024
EXTREMES = (b"\x00\x00\x00\x00", b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f", b"\x00\x00\x00\x80", b"\x01\x00\x00\x00")
NUMBERS = (b"0", b"-1", b"2147483647", b"4294967296", b"99999999999999999999", b"1e999", b"nan", b"0.5", b"")
NUMBER = re.compile(rb"\d+")


def mutants(
    data: bytes, count: int, seed: int, *, repair: Callable[[bytes], bytes] | None = None
) -> Iterator[tuple[str, bytes]]:
    """Damaged copies of a file.

    Args:
        data: The whole file.
        count: How many.
        seed: Same seed, same copies.
        repair: Applied to every second copy: puts checksums right, so that damage gets past them.

    Yields:
        What was done, and the copy; it always differs from `data`.
    """
    rng = np.random.default_rng(seed)
    done = 0
    while done < count:
        names, copy = [], data
        for _ in range(int(rng.choice([1, 1, 1, 2, 4]))):
            name = str(rng.choice(list(DAMAGE)))
            copy = DAMAGE[name](copy, rng)
            names.append(name)
        if repair is not None and done % 2:
            copy = repair(copy)
            names.append("repair")
        if copy != data:
            done += 1
            yield "+".join(names), copy


def position(data: bytes, rng: np.random.Generator) -> int:
    """Where to strike: every second time among the first 512 bytes, where headers are."""
    end = min(len(data), 512) if rng.random() < 0.5 else len(data)
    return int(rng.integers(max(end, 1)))


def flip(data: bytes, rng: np.random.Generator) -> bytes:
    """Flip up to eight bits."""
    copy = bytearray(data)
    for _ in range(int(rng.integers(1, 9))):
        if copy:
            copy[position(data, rng)] ^= 1 << int(rng.integers(8))
    return bytes(copy)


def overwrite(data: bytes, rng: np.random.Generator) -> bytes:
    """Put random bytes over a stretch."""
    at, junk = position(data, rng), rng.bytes(int(rng.integers(1, 64)))
    return data[:at] + junk + data[at + len(junk) :]


def extreme(data: bytes, rng: np.random.Generator) -> bytes:
    """Put an extreme 32-bit number over four bytes."""
    at = position(data, rng)
    return data[:at] + EXTREMES[int(rng.integers(len(EXTREMES)))] + data[at + 4 :]


def truncate(data: bytes, rng: np.random.Generator) -> bytes:
    """Cut the file short."""
    return data[: position(data, rng)]


def delete(data: bytes, rng: np.random.Generator) -> bytes:
    """Take a stretch out."""
    at = position(data, rng)
    return data[:at] + data[at + int(rng.integers(1, 256)) :]


def double(data: bytes, rng: np.random.Generator) -> bytes:
    """Repeat a stretch."""
    at, length = position(data, rng), int(rng.integers(1, 256))
    return data[: at + length] + data[at:]


def number(data: bytes, rng: np.random.Generator) -> bytes:
    """Put another number in the place of one written in digits."""
    found = list(NUMBER.finditer(data[:4096]))
    if not found:
        return extreme(data, rng)
    match = found[int(rng.integers(len(found)))]
    return data[: match.start()] + NUMBERS[int(rng.integers(len(NUMBERS)))] + data[match.end() :]


DAMAGE: dict[str, Callable[[bytes, np.random.Generator], bytes]] = {
    "flip": flip,
    "overwrite": overwrite,
    "extreme": extreme,
    "truncate": truncate,
    "delete": delete,
    "double": double,
    "number": number,
}


def repair_e57(data: bytes) -> bytes:
    """Put the checksum of every page of an E57 file right (CRC-32C of 1,020 bytes, big-endian)."""
    pages = [data[start : start + E57_PAGE] for start in range(0, len(data), E57_PAGE)]
    return b"".join(
        page[:-4] + crc32c(page[:-4]).to_bytes(4, "big") if len(page) == E57_PAGE else page for page in pages
    )


def crc32c(data: bytes) -> int:
    """CRC-32C, Castagnoli's polynomial, byte by byte.

    Example:
        >>> hex(crc32c(b"123456789"))
        '0xe3069283'
    """
    value = 0xFFFFFFFF
    for byte in data:
        value = (value >> 8) ^ CRC_TABLE[(value ^ byte) & 0xFF]
    return value ^ 0xFFFFFFFF


def _crc_entry(byte: int) -> int:
    for _ in range(8):
        byte = (byte >> 1) ^ (0x82F63B78 if byte & 1 else 0)
    return byte


CRC_TABLE = [_crc_entry(byte) for byte in range(256)]
