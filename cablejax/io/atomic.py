"""Files written whole or not at all: a killed, failed or out-of-space write leaves the old file as it was."""

import contextlib
import errno
import glob
import os
import secrets
import time
from collections.abc import Iterator
from pathlib import Path
from typing import IO, BinaryIO

try:
    import fcntl
except ImportError:  # Windows: parts of killed writes stay
    fcntl = None

PART_SUFFIX = ".part"
STALE_S = 60.0


@contextlib.contextmanager
def atomic_write(path: str | os.PathLike[str]) -> Iterator[BinaryIO]:
    """Open a new file that takes the place of `path` only when the block ends without an error.

    The bytes go to a hidden file in the same folder (a rename across file systems is a copy), reach the disk with
    `fsync`, and are renamed over `path` in one step. A link is followed, an existing file's permissions are kept.

    Args:
        path: The file to write. Its folder must exist.

    Yields:
        The open file, binary, seekable, for reading and writing.

    Raises:
        OSError: Whatever the system says, out-of-space in plain words; the file at `path` is then untouched.

    Example:
        >>> import tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     with atomic_write(f"{folder}/a.bin") as file:
        ...         _ = file.write(b"abc")
        ...     Path(folder, "a.bin").read_bytes()
        b'abc'
    """
    target = Path(os.path.realpath(path))
    part = target.with_name(f".{target.name}.{secrets.token_hex(4)}{PART_SUFFIX}")
    try:
        if target.exists() and not target.is_file():  # a rename would put a file in the place of a device or a folder
            raise OSError(errno.EISDIR if target.is_dir() else errno.EINVAL, "is no regular file", os.fspath(path))
        sweep(target)
        with part.open("x+b") as file:
            lock(file)
            yield file
            file.flush()
            os.fsync(file.fileno())
        with contextlib.suppress(FileNotFoundError):
            part.chmod(target.stat().st_mode & 0o7777)
        part.replace(target)
        _sync_folder(target.parent)
    except OSError as error:
        raise _worded(error, path) from error
    finally:
        part.unlink(missing_ok=True)


def lock(file: IO[bytes]) -> bool:
    """Mark an open file as in use, until it is closed or its process dies; False where another process has done so."""
    if fcntl is None:
        return False
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def sweep(target: Path) -> None:
    """Remove what killed writes of a file left behind: hidden parts that are a minute old and that nobody holds."""
    for part in target.parent.glob(f".{glob.escape(target.name)}.????????{PART_SUFFIX}"):
        with contextlib.suppress(OSError), part.open("rb") as file:
            if time.time() - part.stat().st_mtime > STALE_S and lock(file):
                part.unlink()


def remove_parts(folder: Path, name: str) -> None:
    """Remove what killed writes of files matching `name` (a glob pattern) left in a folder with a single writer."""
    for part in folder.glob(f".{name}.*{PART_SUFFIX}"):
        part.unlink(missing_ok=True)


def _sync_folder(folder: Path) -> None:
    """Make a rename survive a power cut; not every system lets a folder be opened or synchronised."""
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def _worded(error: OSError, path: str | os.PathLike[str]) -> OSError:
    """The same error, saying what happened to the file the caller asked for."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        return OSError(error.errno, "not enough space to write the file; nothing was changed", os.fspath(path))
    return error
