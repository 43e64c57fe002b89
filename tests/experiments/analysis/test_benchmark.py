"""The benchmarks' files have one layout: what `benchmarks.record` writes and what is committed is read back."""

import json
from pathlib import Path

import pytest

from benchmarks import record
from experiments import ROOT
from experiments.analysis.benchmark import Benchmark

COMMITTED = sorted(path.stem for path in (ROOT / "results" / "benchmarks").glob("*.json"))


def test_what_is_written_is_read(tmp_path: Path):
    rows = [{"contender": "ours", "median_s": 0.5}, {"contender": "theirs", "median_s": 1.0}]
    tables = {"race": record.table(rows, title="a race", config={"k": 5}), "notes": record.table([])}
    record.write(tmp_path / "new" / "made_up.json", tables, seeds=[3], config={"k": 5})
    found = Benchmark.read(tmp_path / "new", "made_up")
    assert found is not None
    assert found.rows("race") == rows == record.earlier_rows(tmp_path / "new" / "made_up.json", "race")
    assert (found.tables["race"].title, found.tables["race"].config) == ("a race", {"k": 5})
    assert found.rows("notes") == found.rows("none of that name") == []
    assert found.provenance["seeds"] == [3]
    assert found.provenance["cpu"]["model"] in found.machine


def test_a_file_that_is_not_there_is_none(tmp_path: Path):
    assert Benchmark.read(tmp_path, "none") is None
    assert record.earlier_rows(tmp_path / "none.json", "rows") == []


@pytest.mark.parametrize("content", [{"rows": [], "provenance": {}}, []], ids=["rows", "list"])
def test_another_layout_is_refused_by_name(tmp_path: Path, content):
    (tmp_path / "old.json").write_text(json.dumps(content))
    with pytest.raises(ValueError, match=r"old\.json: expected tables and provenance"):
        Benchmark.read(tmp_path, "old")


@pytest.mark.parametrize("name", COMMITTED)
def test_the_committed_files_are_laid_out_so(name: str):
    found = Benchmark.read(ROOT / "results" / "benchmarks", name)
    assert found is not None
    assert any(table.rows for table in found.tables.values())
    assert {"versions", "cpu", "date"} <= set(found.provenance)
