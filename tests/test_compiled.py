"""The cache of compiled programs: whole entries or none, bounded, one folder a processor, the user's wishes first."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from cablejax.compiled import ProgramStore, cache_root, processor

ROOT = Path(__file__).resolve().parents[1]
CPUINFO = (
    "processor\t: 0\nvendor_id\t: X\nmodel\t\t: 17\ncpu MHz\t\t: {mhz}\nflags\t\t: fpu {flags}\n\nprocessor\t: 1\n"
)

COMPILE = """
import collections, sys
from cablejax.compiled import keep_compiled
folder = keep_compiled()
import jax
events = collections.Counter()
jax.monitoring.register_event_listener(lambda event, **_: events.update([event.rsplit("/", 1)[-1]]))
jax.jit(lambda x: x * 3 + 1)(jax.numpy.float32(2)).block_until_ready()
print(folder, jax.config.jax_compilation_cache_dir, events["cache_hits"], events["cache_misses"])
"""
PUT_AND_GET = """
import sys
from pathlib import Path
from cablejax.compiled import ProgramStore
folder = Path(sys.argv[1])
store, value = ProgramStore(folder, folder.parent, limit_bytes=250_000), bytes([int(sys.argv[2])]) * 100_000
for turn in range(100):
    store.put(str(turn % 4), value)
    found = store.get(str(turn % 4))
    assert found is None or (len(found) == 100_000 and len(set(found)) == 1), len(found)
"""


def start(code: str, *arguments: str, **environment: str) -> subprocess.Popen[str]:
    """Python in a process of its own, without the cache that the tests set."""
    ours = ("JAX_COMPILATION_CACHE_DIR", "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "CABLEJAX_CACHE")
    clean = {name: value for name, value in os.environ.items() if name not in ours}
    return subprocess.Popen(
        [sys.executable, "-c", code, *arguments],
        env=clean | environment,
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def finished(process: subprocess.Popen[str]) -> str:
    """Its output; it must have succeeded without a word on stderr."""
    out, error = process.communicate()
    assert (process.returncode, error) == (0, "")
    return out.strip()


@pytest.fixture
def store(tmp_path: Path) -> ProgramStore:
    (tmp_path / "here").mkdir()
    return ProgramStore(tmp_path / "here", tmp_path, limit_bytes=1000)


def only_entry(store: ProgramStore) -> Path:
    (path,) = store._path.iterdir()
    return path


def test_what_was_put_is_got(store):
    assert store.get("a") is None
    store.put("a", b"program")
    store.put("a", b"newer")
    assert (store.get("a"), store.get("b")) == (b"newer", None)
    only_entry(store)  # nothing half-written stays beside it


@pytest.mark.parametrize("damage", [lambda b: b[:-1], lambda b: b[:2], lambda b: b"", lambda b: b[:-1] + b"?"])
def test_a_damaged_entry_is_none_and_is_replaced(store, damage):
    store.put("a", b"program")
    path = only_entry(store)
    path.write_bytes(damage(path.read_bytes()))
    assert store.get("a") is None
    store.put("a", b"program")
    assert store.get("a") == b"program"


def test_the_oldest_go_whatever_processor_they_are_of(store, tmp_path):
    (tmp_path / "other").mkdir()
    other = ProgramStore(tmp_path / "other", tmp_path, limit_bytes=1000)
    for age, (of, key) in enumerate([(other, "old"), (store, "a"), (store, "b")]):
        of.put(key, bytes(296))  # and 4 of checksum
        os.utime(of._place(key), (age, age))
    (tmp_path / "other" / "killed.part").write_bytes(bytes(10))
    os.utime(tmp_path / "other" / "killed.part", (0, 0))
    assert store.get("a") is not None  # renewed: b is older now
    store.put("c", bytes(296))
    found = [of.get(key) is not None for of, key in ((other, "old"), (store, "a"), (store, "b"), (store, "c"))]
    assert found == [False, True, False, True]  # 1,210 bytes came down to 800 or less
    assert not (tmp_path / "other" / "killed.part").exists()


def test_a_folder_that_has_gone_is_no_error(tmp_path):
    store = ProgramStore(tmp_path / "gone", tmp_path)
    store.put("a", b"program")
    assert store.get("a") is None


def test_processes_that_write_and_evict_at_once_read_whole_entries(tmp_path):
    (tmp_path / "here").mkdir()
    for process in [start(PUT_AND_GET, str(tmp_path / "here"), str(number)) for number in range(3)]:
        finished(process)


def test_a_second_process_compiles_nothing(tmp_path):
    first, second = (finished(start(COMPILE, CABLEJAX_CACHE=str(tmp_path))).split() for _ in range(2))
    assert Path(first[0]).parent == tmp_path
    assert first[0] == first[1] == second[0]
    assert int(first[3]) > 0
    assert (int(second[2]) > 0, int(second[3])) == (True, 0)
    assert {path.suffix for path in Path(first[0]).iterdir()} == {".xla"}  # written by the store, not by jax's own


def test_the_users_wishes_come_first(tmp_path):
    assert finished(start(COMPILE, CABLEJAX_CACHE="")).split()[:2] == ["None", "None"]
    own = finished(start(COMPILE, JAX_COMPILATION_CACHE_DIR=str(tmp_path / "own"), CABLEJAX_CACHE=str(tmp_path)))
    assert own.split()[:2] == ["None", str(tmp_path / "own")]
    assert [path.name for path in tmp_path.iterdir()] in ([], ["own"])


def test_a_place_that_cannot_be_written(tmp_path):
    blocked = tmp_path / "file"
    blocked.write_text("")
    named = start(COMPILE, CABLEJAX_CACHE=str(blocked))
    out, error = named.communicate()
    assert out.split()[:2] == ["None", "None"]
    assert f"CABLEJAX_CACHE: expected a folder that can be written, got {blocked}" in error
    assert finished(start(COMPILE, XDG_CACHE_HOME=str(blocked))).split()[:2] == ["None", "None"]


def test_where_it_lies(monkeypatch):
    monkeypatch.delenv("CABLEJAX_CACHE", raising=False)
    monkeypatch.setenv("HOME", "/home/someone")
    monkeypatch.setenv("XDG_CACHE_HOME", "")
    assert cache_root() == Path("/home/someone/.cache/cablejax")
    monkeypatch.setenv("XDG_CACHE_HOME", "/var/cache/someone")
    assert cache_root() == Path("/var/cache/someone/cablejax")
    monkeypatch.setenv("CABLEJAX_CACHE", "~/elsewhere")
    assert cache_root() == Path("/home/someone/elsewhere")
    monkeypatch.setenv("CABLEJAX_CACHE", "")
    assert cache_root() is None


def test_each_processor_has_a_folder_of_its_own(tmp_path, monkeypatch):
    def of(mhz: int, flags: str) -> str:
        (tmp_path / "cpuinfo").write_text(CPUINFO.format(mhz=mhz, flags=flags))
        return processor(tmp_path / "cpuinfo")

    monkeypatch.setenv("NPROC", "2")
    assert of(2000, "avx2") == of(3000, "avx2")
    assert of(2000, "avx2") != of(2000, "avx2 avx512f")
    two = of(2000, "avx2")
    monkeypatch.setenv("NPROC", "1")
    assert of(2000, "avx2") != two
    assert processor(tmp_path / "missing")
