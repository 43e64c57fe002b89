"""Atomic writes: the old file or the new one, nothing between."""

import os
import stat

import pytest

from cablejax.io import atomic_write
from cablejax.io.atomic import lock


def test_an_error_inside_leaves_the_old_file(tmp_path):
    path = tmp_path / "a"
    path.write_bytes(b"old")

    def fail():
        with atomic_write(path) as file:
            file.write(b"new")
            assert path.read_bytes() == b"old"
            raise KeyError

    with pytest.raises(KeyError):
        fail()
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["a"]


def test_links_and_permissions_stay(tmp_path):
    (tmp_path / "real").mkdir()
    target = tmp_path / "real" / "a"
    target.write_bytes(b"old")
    target.chmod(0o640)
    link = tmp_path / "link"
    link.symlink_to(target)
    with atomic_write(link) as file:
        file.write(b"new")
    assert link.is_symlink()
    assert target.read_bytes() == b"new"
    assert stat.S_IMODE(target.stat().st_mode) == 0o640


def test_a_new_file_follows_the_umask(tmp_path):
    old = os.umask(0o027)
    try:
        with atomic_write(tmp_path / "a") as file:
            file.write(b"")
    finally:
        os.umask(old)
    assert stat.S_IMODE((tmp_path / "a").stat().st_mode) == 0o640


def test_a_missing_folder_is_an_error(tmp_path):
    with pytest.raises(FileNotFoundError), atomic_write(tmp_path / "absent" / "a"):
        pass


@pytest.mark.skipif(os.name != "posix", reason="file locks")
def test_parts_of_killed_writes_are_swept_and_others_stay(tmp_path):
    stale, held, fresh, other = (
        tmp_path / name for name in (".a.0badcafe.part", ".a.11111111.part", ".a.22222222.part", ".ab.33333333.part")
    )
    for part in (stale, held, fresh, other):
        part.write_bytes(b"half")
    for part in (stale, held, other):
        os.utime(part, (0, 0))
    with held.open("rb") as file:
        assert lock(file)
        with atomic_write(tmp_path / "a") as new:
            new.write(b"whole")
    assert not stale.exists()
    assert held.exists()
    assert fresh.exists()
    assert other.exists()
