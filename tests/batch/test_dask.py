"""The same batch on a Dask cluster: the same table, though a worker is killed in the middle."""

import os
import signal
import subprocess
import sys
import time

import pytest

pytest.importorskip("distributed")

from cablejax.io import write_points
from tests.batch import folders
from tests.batch.cluster import cluster
from tests.reference.circles import bent_cable

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals")


def test_a_worker_killed_in_the_middle_costs_a_retry_and_nothing_else(tmp_path):
    folders.fill(tmp_path / "scans", scans=8, broken=2, slow=3)
    measure = ["measure", str(tmp_path / "scans"), "--unit", "mm"]
    here = tmp_path / "here.csv"
    assert folders.run(*measure, "--csv", str(here), "--jobs", "1").returncode == 0
    table = tmp_path / "dask.csv"
    with cluster(tmp_path, workers=3) as dask:
        command = folders.command(*measure, "--csv", str(table), "--scheduler", dask.address)
        process = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, cwd=folders.ROOT, text=True
        )
        while folders.lines_of(table) < 3 or not (
            busy := [one for one in dask.workers if folders.children_of(one.pid)]
        ):
            assert process.poll() is None
            time.sleep(0.01)
        victim, child = busy[0], folders.children_of(busy[0].pid)[0]
        victim.kill()
        assert process.communicate()[0] is None
        assert process.returncode == 0
        assert sum(one.poll() is None for one in dask.workers) == 2
    assert table.read_bytes() == here.read_bytes()
    assert victim.returncode == -signal.SIGKILL
    assert not folders.alive(child)


def test_a_scheduler_that_goes_is_one_sentence_and_the_rows_stay(tmp_path):
    folders.fill(tmp_path / "scans", scans=12, broken=0, slow=2)
    table = tmp_path / "t.csv"
    measure = ["measure", str(tmp_path / "scans"), "--unit", "mm", "--csv", str(table), "--quiet"]
    with cluster(tmp_path, workers=1) as dask:
        command = folders.command(*measure, "--scheduler", dask.address)
        process = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, cwd=folders.ROOT, text=True
        )
        while folders.lines_of(table) < 3:
            assert process.poll() is None
            time.sleep(0.01)
        dask.scheduler.kill()
        said = process.communicate(timeout=120)[1]
    assert process.returncode == 1
    assert f"cablejax: --scheduler {dask.address}: the scheduler has gone" in said
    assert "Traceback" not in said
    assert 2 <= folders.lines_of(table) - 1 < 12


def test_tiles_on_a_cluster_that_loses_a_worker(tmp_path):
    scan = tmp_path / "scan.ply"
    write_points(scan, bent_cable(n=8000))
    denoise = ["denoise", str(scan), "--unit", "mm", "--tile", "2048", "--neighbors", "16"]
    here = tmp_path / "here.ply"
    assert folders.run(*denoise, str(here), "--jobs", "1").returncode == 0
    there = tmp_path / "there.ply"
    with cluster(tmp_path, workers=3) as dask:
        command = folders.command(*denoise, str(there), "--scheduler", dask.address)
        process = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, cwd=folders.ROOT, text=True
        )
        assert process.stderr is not None
        said = next(line for line in process.stderr if line.startswith("scoring: 1 "))
        busy = next(one for one in dask.workers if folders.children_of(one.pid))
        busy.kill()
        left = process.communicate()[1]
        assert process.returncode == 0, said + left
    assert there.read_bytes() == here.read_bytes()


# A second for a scheduler to answer, not half a minute.
IMPATIENT = """
import sys
from cablejax.batch import engine
from cablejax.cli import main
engine.CONNECT_S = 1.0
sys.exit(main(sys.argv[1:]))
"""


def test_no_scheduler_is_one_sentence(tmp_path):
    folders.fill(tmp_path / "scans", scans=1, broken=0)
    arguments = ["info", str(tmp_path / "scans"), "--unit", "mm", "--scheduler", "tcp://127.0.0.1:9", "--quiet"]
    command = [sys.executable, "-c", IMPATIENT, *arguments]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folders.ROOT)
    assert done.returncode == 1
    assert done.stderr.startswith("cablejax: --scheduler tcp://127.0.0.1:9: no Dask scheduler answers there")
    assert "Traceback" not in done.stderr
