"""A cache of compiled programs that the user need not know of, for the programs that cablejax brings.

`keep_compiled` points jax at a folder of the user's cache. jax's own cache there has no bound unless a further package is
installed, and then waits on a lock; it writes in place, so that another process can read half an entry. Here an entry is
written beside its place and moved, carries a checksum, and the oldest go when all together grow beyond a bound. What one
processor compiled another cannot always run, so the folder is one of the processor's own.
"""

import contextlib
import hashlib
import os
import platform
import uuid
import warnings
import zlib
from pathlib import Path

VARIABLE = "CABLEJAX_CACHE"
LIMIT_BYTES = 1 << 30
AFTER_EVICTION = 0.8  # of the limit: so the folder is walked rarely
ENDING = ".xla"
PROCESSOR_LINES = (
    "vendor_id", "cpu family", "model", "flags",
    "CPU implementer", "CPU architecture", "CPU part", "Features",
)  # fmt: skip


def keep_compiled() -> Path | None:
    """Let jax keep what it compiles from now on, and load what was compiled before.

    `CABLEJAX_CACHE` names another folder than `cablejax` in the user's cache (`XDG_CACHE_HOME`, else `~/.cache`); with an
    empty value nothing is kept. A cache that is configured in jax already (`JAX_COMPILATION_CACHE_DIR`) stays as it is.

    Returns:
        The folder, or None where this function changed nothing.
    """
    # Each program loaded is called a possible mismatch, in kilobytes of text, because of tuning hints (prefer-no-gather)
    # that no processor lists; 3 leaves fatal errors alone. XLA reads it with its first message.
    if os.environ.get("TF_CPP_MIN_LOG_LEVEL", "1") == "1":  # 1 is what jax sets
        os.environ["TF_CPP_MIN_LOG_LEVEL"] = "3"
    import jax
    from jax._src import compilation_cache

    root = cache_root()
    if root is None or jax.config.values["jax_compilation_cache_dir"]:
        return None
    folder = root / f"jax-{jax.__version__}-{processor()}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        usable = os.access(folder, os.W_OK)
    except OSError:
        usable = False
    if not usable:
        if VARIABLE in os.environ:  # in the default place, a home that cannot be written is nobody's mistake
            warnings.warn(f"{VARIABLE}: expected a folder that can be written, got {root}", stacklevel=2)
        return None
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    compilation_cache.get_file_cache = lambda path: (ProgramStore(Path(path), root), path)
    return folder


def trace_store() -> "ProgramStore | None":
    """Where traces are kept: with the compiled programs; None where those are not kept."""
    import jax

    given = jax.config.values["jax_compilation_cache_dir"]
    if not given:
        return None
    folder, root = Path(given), cache_root()
    if root is not None and folder.parent == root:
        return ProgramStore(folder, root)
    folder = folder / "traces"  # not ours: nothing else in it is bounded
    with contextlib.suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
    return ProgramStore(folder, folder.parent)


def cache_root() -> Path | None:
    """The folder of all processors' programs; None where the user wants none."""
    given = os.environ.get(VARIABLE)
    if given is not None:
        return Path(given).expanduser() if given else None
    return Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser() / "cablejax"


def processor(cpuinfo: Path = Path("/proc/cpuinfo")) -> str:
    """What a compiled program depends on beside jax: the processor's model, its features, and how many threads it has."""
    try:
        first = cpuinfo.read_text().split("\n\n")[0]
        lines = [line for line in first.splitlines() if line.split(":")[0].strip() in PROCESSOR_LINES]
    except OSError:  # not Linux
        lines = [platform.processor()]
    threads = os.environ.get("NPROC", os.cpu_count())
    text = "\n".join([platform.system(), platform.machine(), str(threads), *lines])
    return f"{platform.machine()}-{hashlib.sha256(text.encode()).hexdigest()[:12]}"


class ProgramStore:
    """Compiled programs by key, in the form that `jax._src.compilation_cache` asks for: `get` and `put`.

    Nothing here raises on the state of the disk: without the cache a program is compiled again, no more.

    Args:
        folder: Where the entries of this processor lie.
        root: The folder whose entries together are bounded.
        limit_bytes: That bound.
    """

    def __init__(self, folder: Path, root: Path, *, limit_bytes: int = LIMIT_BYTES):
        self._path, self._root, self._limit = folder, root, limit_bytes
        self._left: int | None = None  # bytes until the folder is walked again

    def get(self, key: str) -> bytes | None:
        """The program, None where there is none or the entry is damaged; its age starts anew."""
        path = self._place(key)
        try:
            entry = path.read_bytes()
            os.utime(path)
        except OSError:
            return None
        program = entry[4:]
        return program if entry[:4] == _checksum(program) else None

    def put(self, key: str, value: bytes) -> None:
        """Keep a program; one of the same key is replaced in one step."""
        part = self._path / f"{uuid.uuid4().hex}.part"
        try:
            part.write_bytes(_checksum(value) + value)
            part.replace(self._place(key))
            self._bound(len(value))
        except OSError:  # a full disk, a folder that has gone
            with contextlib.suppress(OSError):
                part.unlink()

    def _place(self, key: str) -> Path:
        return self._path / f"{hashlib.sha256(key.encode()).hexdigest()}{ENDING}"

    def _bound(self, added: int) -> None:
        """Delete the oldest entries, of other processors and releases too, where all together are too many."""
        self._left = None if self._left is None else self._left - added
        if self._left is not None and self._left > 0:
            return
        entries = sorted(_entries(self._root))
        total = sum(size for _, size, _ in entries)
        if total > self._limit:
            for _, size, path in entries:
                if total <= AFTER_EVICTION * self._limit:
                    break
                path.unlink(missing_ok=True)
                total -= size
        self._left = self._limit - total


def _entries(root: Path) -> list[tuple[int, int, Path]]:
    """Time of last use, bytes and path of each file, those that a killed process left half-written too."""
    found = []
    for path in root.glob("*/*"):
        if path.suffix in (ENDING, ".part"):
            try:
                status = path.stat()
            except OSError:  # another process has deleted it
                continue
            found.append((status.st_mtime_ns, status.st_size, path))
    return found


def _checksum(program: bytes) -> bytes:
    return zlib.crc32(program).to_bytes(4, "big")
