"""Tables that are written while they grow, and read back after a kill."""

import json

import pytest

from cablejax.batch import Column, Table, TableError, columns_of

COLUMNS = columns_of([Column("size_mm", "number", "a size"), Column("whole", "flag", "a flag")])
NAMES = [column.name for column in COLUMNS]
ENDINGS = pytest.mark.parametrize("ending", [".csv", ".jsonl"])


def row(file: str, *, cable=1, cables=1, **cells):
    return {**dict.fromkeys(NAMES), "file": file, "cable": cable, "cables": cables, "outcome": "result", **cells}


def read(path):
    """The complete scans of a table."""
    with Table(path, COLUMNS) as table:
        return table.known


def write(path, *scans):
    with Table(path, COLUMNS) as table:
        for rows in scans:
            table.add(rows)


ROWS = {
    "b, with \"quotes\".ply": [row("b, with \"quotes\".ply", size_mm=0.1 + 0.2, whole=True, bytes=2**60)],
    "a.ply": [row("a.ply", cable=1, cables=2, size_mm=1e-300), row("a.ply", cable=2, cables=2, size_mm=-5.0)],
    "broken.ply": [row("broken.ply", cable=None, cables=0, error="é; \\n, so", whole=False)],
}  # fmt: skip


@ENDINGS
def test_rows_come_back_as_they_were(tmp_path, ending):
    path = tmp_path / f"t{ending}"
    write(path, *ROWS.values())
    with Table(path, COLUMNS) as table:
        assert table.known == ROWS
        assert table.finish(sorted(ROWS)) == 0
    assert list(read(path)) == sorted(ROWS)
    assert read(path) == ROWS


@ENDINGS
def test_cut_off_anywhere_whole_scans_are_left_and_the_table_goes_on(tmp_path, ending):
    path = tmp_path / f"t{ending}"
    write(path, *ROWS.values())
    content = path.read_bytes()
    header = content.index(b"\n") + 1 if ending == ".csv" else 0
    for length in range(header, len(content), 11):
        path.write_bytes(content[:length])
        with Table(path, COLUMNS) as table:
            assert table.known == {file: ROWS[file] for file in table.known}
            for file in ROWS.keys() - table.known.keys():
                table.add(ROWS[file])
            table.finish(ROWS)
        assert path.read_bytes() == content


@ENDINGS
def test_later_rows_replace_earlier_ones(tmp_path, ending):
    path = tmp_path / f"t{ending}"
    write(path, ROWS["a.ply"], [row("a.ply", size_mm=7.0)])
    assert read(path) == {"a.ply": [row("a.ply", size_mm=7.0)]}


@ENDINGS
def test_files_that_are_gone_are_left_out_and_counted(tmp_path, ending):
    path = tmp_path / f"t{ending}"
    write(path, *ROWS.values())
    with Table(path, COLUMNS) as table:
        assert table.finish(["a.ply"]) == 2
    assert list(read(path)) == ["a.ply"]


@ENDINGS
@pytest.mark.parametrize("content", ["a,b\n1,2\n", "{}\n", "null\n", '{"file": "a.ply"}\n', "text\n"])
def test_another_file_is_not_overwritten_unless_asked(tmp_path, ending, content):
    path = tmp_path / f"t{ending}"
    path.write_text(content)
    with pytest.raises(TableError, match="is no table of this command; give another name, or --no-resume"):
        Table(path, COLUMNS)
    assert path.read_text() == content
    with Table(path, COLUMNS, fresh=True) as table:
        assert table.known == {}


def test_rows_of_a_csv_that_were_changed_are_done_again(tmp_path):
    path = tmp_path / "t.csv"
    write(path, [row("a.ply", size_mm=1.5)], [row("b.ply", size_mm=2.5)])
    path.write_text(path.read_text().replace("2.5", "two and a half"))
    assert list(read(path)) == ["a.ply"]


@ENDINGS
def test_two_runs_do_not_write_one_table(tmp_path, ending):
    pytest.importorskip("fcntl")
    with Table(tmp_path / f"t{ending}", COLUMNS), pytest.raises(TableError, match="another run is writing it"):
        Table(tmp_path / f"t{ending}", COLUMNS)
    read(tmp_path / f"t{ending}")


def test_json_lines_have_every_column_in_order(tmp_path):
    write(tmp_path / "t.jsonl", ROWS["broken.ply"])
    assert list(json.loads((tmp_path / "t.jsonl").read_text())) == NAMES
