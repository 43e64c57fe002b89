"""Committed runs of the study stand for the sources that are here; what stands no longer is replayed, then accepted or named."""

import sys
from pathlib import Path
from typing import Any

import pytest

from experiments import study
from experiments.harness import run_log
from experiments.harness.schema import Config
from experiments.material import replay
from experiments.material.study_plan import PARTS, SEARCH, Job, config_of

PART = "standard_nofit"
OLD, NEW = {"cablejax.x": "1"}, {"cablejax.x": "2"}
LOSS = 2.0


@pytest.mark.parametrize("part", PARTS)
def test_no_committed_run_is_stale(part: str):
    rows = run_log.lines(study.LOG / f"{part}.jsonl")
    old = run_log.stale(study.LOG, rows, study.sources(part))
    changed = run_log.changed(study.LOG, old[0], study.sources(part)) if old else []
    assert not old, (
        f"{len(old)} of {len(rows)} runs of results/study/{part}.jsonl were made by other sources ({', '.join(changed)}): "
        "`python -m experiments.verify study` replays one and accepts the present sources if it agrees"
    )


class Training:
    """Made-up training whose second update has a loss that can be changed."""

    loss = LOSS

    def __init__(self):
        self.odd: tuple[str, ...] = ()  # arms whose second loss is another one on this processor

    def measured(self, cfg: Config) -> dict[str, Any]:
        assert (cfg.training.give_up_epoch, cfg.training.give_up_loss) == (1, float("-inf"))
        return {"history": [{"losses": [LOSS, 1.001 * LOSS if cfg.optimizer.name in self.odd else self.loss, 9.0]}]}


@pytest.fixture
def training(monkeypatch: pytest.MonkeyPatch) -> Training:
    found = Training()
    monkeypatch.setitem(sys.modules, PARTS[PART].module, found)  # pyright: ignore[reportArgumentType]
    monkeypatch.setattr(replay, "present", lambda module, unused: NEW)
    return found


def line(log: Path, sources: dict[str, str], trial: int, arm: str = "adam", rate: float = 0.1) -> run_log.Line:
    job = Job(SEARCH, arm, trial, 0)
    history = {key: [LOSS, 1.0] for key in run_log.COLUMNS}
    return {**job._asdict(), "size": "smoke", "config": run_log.config_digest(config_of(PART, job, size="smoke")),
            "metrics": {"validation_overall": 0.3 + trial, "learning_rate": rate, "history": history,
                        "first_losses": [LOSS, LOSS]},
            "origin": run_log.register(log, {"sources": sources})}  # fmt: skip


@pytest.mark.parametrize(("share", "same"), [(0.0, True), (0.5, True), (1.5, False), (float("nan"), False)])
def test_sources_that_agree_are_accepted_and_others_named(training: Training, tmp_path: Path, share: float, same: bool):
    """Within the tolerance a replay accepts the sources for all runs of the old ones, once; beyond, nothing is."""
    told: list[str] = []
    for trial in (0, 1):
        run_log.append(tmp_path / f"{PART}.jsonl", line(tmp_path, OLD, trial))
    training.loss = LOSS * (1 + share * replay.TOLERANCE[1])
    assert replay.verify_part(PART, tmp_path, told.append) == same
    rows = run_log.lines(tmp_path / f"{PART}.jsonl")
    assert run_log.stale(tmp_path, rows, NEW) == ([] if same else rows)
    assert len(run_log.origins(tmp_path)["accepted"]) == same
    assert ("accepted" in told[-1 - same]) == same
    assert ("cablejax.x" in told[-1]) != same
    if same:
        told.clear()
        assert replay.verify_part(PART, tmp_path, told.append)  # nothing left to replay
        assert told == [f"{PART}: 2 runs stand for the present sources"]


def test_of_each_arm_the_slowest_rate_that_learnt_is_replayed(tmp_path: Path):
    rates = {"adam": (0.1, 0.01, 1.0), "mbgd": (3.0, 2.0, 5.0)}
    rows = [line(tmp_path, OLD, trial, arm, rate) for arm, own in rates.items() for trial, rate in enumerate(own)]
    # Trial 0 has learnt too little.
    assert [(row["arm"], row["trial"]) for row in replay.samples(rows)] == [("adam", 1), ("mbgd", 1)]


@pytest.mark.parametrize(("odd", "same"), [(("adam",), True), (("adam", "mbgd"), False)])
def test_one_run_that_agrees_will_do(training: Training, tmp_path: Path, odd: tuple[str, ...], same: bool):
    """On another processor a quick run may differ though its sources are the same."""
    training.odd, told = odd, []
    for arm in ("adam", "mbgd"):
        run_log.append(tmp_path / f"{PART}.jsonl", line(tmp_path, OLD, 0, arm))
    assert replay.verify_part(PART, tmp_path, told.append) == same
    assert f"{PART}: search adam trial 0 seed 0: the first losses differ by" in told[0]


def test_a_job_configured_otherwise_is_not_replayed(training: Training, tmp_path: Path):
    row = {**line(tmp_path, OLD, 0), "config": "another"}
    run_log.append(tmp_path / f"{PART}.jsonl", row)
    with pytest.raises(ValueError, match="search adam trial 0 seed 0 is configured otherwise now"):
        replay.verify_part(PART, tmp_path, print)


def test_what_cannot_be_replayed_is_said(training: Training, tmp_path: Path):
    row = {**line(tmp_path, OLD, 0), "stage": "final"}
    run_log.append(tmp_path / f"{PART}.jsonl", row)
    told: list[str] = []
    assert not replay.verify_part(PART, tmp_path, told.append)
    assert "none of them a search run" in told[0]
