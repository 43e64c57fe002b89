"""A sweep names what failed, sums up at its end whichever processes its jobs ran in, and goes on after a kill."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from cablejax.io import read_json
from experiments import ROOT
from experiments.harness import app, schema, sweep

COMMAND = [sys.executable, "-m", "tests.experiments.small_job", "-m", "size=smoke", "noise=none"]


def run_in_process(
    task, arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> tuple[sweep.Outcome, ...]:
    monkeypatch.setattr(sys, "argv", ["table1_filtering", "-m", "noise=none", *arguments, f"out={tmp_path}"])
    monkeypatch.setenv("HYDRA_FULL_ERROR", "0")
    with contextlib.suppress(SystemExit):  # how a sweep with a failed job ends
        app.main(task, experiment="table1_filtering", headline=lambda metrics: f"k is {metrics['k']}")
    return sweep.Summary.finished


def test_summary_tells_done_done_before_and_failed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
):
    def task(cfg: schema.Config, folder: Path) -> dict[str, int]:
        if cfg.filter.k == 9:
            raise RuntimeError("a mistake in the code")
        return {"k": cfg.filter.k}

    first = run_in_process(task, ["filter=median", "filter.k=5,7", "seed=0"], tmp_path, monkeypatch)
    assert [job.state for job in first] == [sweep.DONE, sweep.DONE]
    second = run_in_process(task, ["filter=median", "filter.k=5,8,9", "seed=0"], tmp_path, monkeypatch)
    assert [job.state for job in second] == [sweep.DONE_BEFORE, sweep.DONE, sweep.FAILED]
    assert second[2].text == "RuntimeError: a mistake in the code"
    captured = capfd.readouterr()
    assert "3 jobs: 1 done, 1 done before, 1 failed" in captured.out
    assert "filter.k=9" in captured.out.splitlines()[-1]
    assert "Traceback" in captured.err  # an unexpected error keeps what is needed to mend it


def test_a_sweep_killed_half_way_runs_only_what_is_missing(tmp_path: Path):
    command = [*COMMAND, "filter=statistical", "filter.k=5,6,7,8", "seed=0", f"out={tmp_path}"]
    held = {**os.environ, "HELD": "6"}
    with subprocess.Popen(command, cwd=ROOT, env=held, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        first = process.stdout.readline()  # one job is done, and the next under way: now the whole process dies
        process.send_signal(signal.SIGKILL)
    assert "filter.k=5" in first
    done = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("run.json")}
    assert len(done) == 1
    time.sleep(0.01)
    again = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert "4 jobs: 3 done, 1 done before" in again.stdout
    assert all(path.stat().st_mtime_ns == stamp for path, stamp in done.items())


def test_launchers_give_the_same_numbers(tmp_path: Path):
    """joblib's spawned workers against submitit's local executor, a job that fails among them."""
    numbers = {}
    for launcher in ("joblib", "submitit_local"):
        out = tmp_path / launcher
        command = [*COMMAND, f"launcher={launcher}", "filter=statistical", "filter.k=0,5", "seed=0", f"out={out}"]
        done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
        assert done.returncode == app.USAGE_ERROR, done.stderr
        assert "2 jobs: 1 done, 1 failed" in done.stdout
        records = [read_json(path) for path in out.rglob("run.json")]
        numbers[launcher] = sorted((r["seed"], r["metrics"]["remaining"], r["metrics"]["rms_mm"]) for r in records)
    assert numbers["joblib"] == numbers["submitit_local"]
