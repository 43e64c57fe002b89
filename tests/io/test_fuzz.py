"""A small seeded sample of what `benchmarks/fuzz_readers.py` does with thousands of files."""

import pytest

from benchmarks.fuzz_files import base_files
from benchmarks.fuzz_readers import UNCOUNTED, fuzz, judge
from benchmarks.mutations import crc32c, mutants, repair_e57

PARSED = ["ply", "pcd", "xyz", "csv", "ascii.ply", "ascii.pcd", "compressed.pcd", "pts", "ptx", "obj", "ply.gz"]
PARSED += [
    "lists.ply",
    "lists_binary.ply",
    "faces.ply",
    "padded.pcd",
    "names.pts",
    "units.txt",
    "cells.csv",
    "index.xyz",
]


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    return base_files(tmp_path_factory.mktemp("fuzz"))


@pytest.mark.parametrize("name", PARSED)
def test_damaged_files_are_refused_or_read_whole(files, tmp_path, name):
    outcomes = []
    whole = judge(files[name])["points"]
    for index, (damage, content) in enumerate(mutants(files[name].read_bytes(), 60, seed=1)):
        path = tmp_path / f"{index}.{name}"
        path.write_bytes(content)
        result = judge(path)
        assert result["outcome"] in ("read", "refused"), (index, damage, result)
        if damage == "truncate" and result["outcome"] == "read" and name not in UNCOUNTED:
            short = any("are there and were read" in note for note in result["notes"])
            assert result["points"] >= whole - short, (index, damage, result)
        outcomes.append(result["outcome"])
    assert "refused" in outcomes


@pytest.mark.parametrize("name", ["laz", "e57"])
def test_damaged_native_files_never_take_the_program_down(files, tmp_path, name):
    row = fuzz(name, files[name], 30, 2, tmp_path)
    assert row["failures"] == []
    assert row["end to end"] >= 1
    assert row["refused"] > 0


def test_the_base_files_are_good(files):
    for name, path in files.items():
        judged = judge(path)
        assert judged["outcome"] == "read", (name, judged)
        assert judged["points"] + judged["dropped"] >= 60


def test_mutants_are_reproducible_and_differ(files):
    data = files["ply"].read_bytes()
    first, second = list(mutants(data, 20, seed=5)), list(mutants(data, 20, seed=5))
    assert first == second
    assert all(content != data for _, content in first)


def test_repaired_checksums_are_right(files):
    data = files["e57"].read_bytes()
    assert repair_e57(data) == data
    assert crc32c(b"123456789") == 0xE3069283  # the check value of the polynomial's definition
