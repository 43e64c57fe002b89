"""The study's path from search to verdict on made-up training: who goes on, what is kept, what is said, what is run again."""

from dataclasses import replace
from pathlib import Path

import pytest

from cablejax.io import read_json
from experiments import study, study_results
from experiments.analysis import rules
from experiments.analysis.results import Results
from experiments.analysis.study_summary import summary, updates_to_target, verdict
from experiments.collect import CollectError
from experiments.display.optimizers import study_figures, study_tables
from experiments.study import CONFIRM, FINAL, PAPER_WAY, PARTS, SEARCH, Job, Records
from tests.experiments import made_up
from tests.experiments.harness.test_configuration import compose_config

PART = "standard_nofit"


def record(part: str, job: Job) -> dict:
    name = "adadelta" if job.arm == PAPER_WAY else job.arm
    config = {
        "seed": job.seed, "trial": job.trial, "rates": "stated" if job.arm == PAPER_WAY else "search",
        "optimizer": {"name": name, "options": {"rho": 0.9}},
        "training": {"epochs": 4, "batch_size": 24}, "dataset": {"sizes_mm2": [25, 50], "train_per_class": 36},
    }  # fmt: skip
    return {"config": config, "seconds": 60.0, "provenance": {}, "code_revision": "abc",
            "metrics": made_up.metrics(job.arm, job.trial, job.seed, test=job.stage == FINAL)}  # fmt: skip


def worked_off(part: str = PART, *, stages: tuple[str, ...] = (SEARCH, CONFIRM, FINAL)) -> Records:
    """A part whose jobs are done as far as these stages."""
    done: Records = {}
    while left := [job for job in study.jobs(part, done) if job not in done and job.stage in stages]:
        done |= {job: record(part, job) for job in left}
    return done


@pytest.fixture
def results(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Results:
    monkeypatch.setattr(study, "finished", lambda part, **place: worked_off(part))
    path = study_results.fold(PART, size="quick", runs=tmp_path, out=tmp_path, allow_dirty=True)
    return Results(read_json(path))


@pytest.mark.parametrize(("part", "size"), [*((part, "quick") for part in PARTS), (PART, "smoke")])
def test_every_job_composes_and_is_found_again(part: str, size: str, tmp_path: Path):
    done = worked_off(part)
    assert len(done) == study.count(part)
    wanted = {("adadelta", SEARCH), ("schedule_free", CONFIRM), (PAPER_WAY, FINAL), ("sgd", FINAL)}
    for job in {(job.arm, job.stage): job for job in done if (job.arm, job.stage) in wanted}.values():
        config = compose_config(*study.overrides(part, job, size=size, out=tmp_path))
        plain = {
            "seed": config.seed,
            "rates": config.rates,
            "trial": config.trial,
            "optimizer": {"name": config.optimizer.name},
        }
        assert study.job_of(part, plain) == job
        assert config.dataset.seed == config.seed
        assert config.dataset.fresh
        assert config.training.test == (job.stage == FINAL)
        paper_way = job.arm == PAPER_WAY
        assert (config.training.warmup_epochs, config.training.clip_norm) == ((0, None) if paper_way else (1, 1))
        assert (config.training.schedule == "constant") == (paper_way or job.arm == "schedule_free")
        assert (config.model.options.get("pose") == "none") == (
            part in ("standard_nofit", "hard_nofit", "gradient_descent")
        )
        assert config.model.options["enhancement"]
        assert config.model.options["fusion"]


@pytest.mark.parametrize("part", PARTS)
def test_stages_share_no_seed(part: str):
    seeds = [0, *PARTS[part].confirm, *PARTS[part].final]
    assert len(set(seeds)) == len(seeds)


def test_the_chosen_trial_is_the_best_over_search_and_confirm():
    """Trial 0 is best on the search's seed and not on the others: one lucky seed chooses nothing."""
    searched = worked_off(stages=(SEARCH,))
    assert (study.confirmed(PART, "adam", searched) or [])[:2] == [0, made_up.BEST_TRIAL]
    assert study.chosen(PART, "adam", searched) is None
    assert study.chosen(PART, "adam", worked_off(stages=(SEARCH, CONFIRM))) == made_up.BEST_TRIAL
    assert {job.trial for job in worked_off() if job.stage == FINAL and job.arm == "adam"} == {made_up.BEST_TRIAL}


def test_only_whole_stages_are_folded():
    done = worked_off()
    assert len(study_results.complete(PART, done)) == len(done)
    lost = next(job for job in done if job.stage == FINAL and job.arm == "muon")
    part_done = {job: each for job, each in done.items() if job != lost}
    kept = study_results.complete(PART, part_done)
    assert len(kept) == len(done) - len(PARTS[PART].final)
    assert not any(job.stage == FINAL and job.arm == "muon" for job in kept)


def test_verdict_tables_and_figures_of_a_finished_part(results: Results):
    word, against = verdict(results)
    assert set(against) == {"sgd", "mbgd", "adagrad", "rmsprop"}
    assert word == rules.REPRODUCED  # .97 against .90 and .20, seed by seed
    assert study_tables.claim(results)[2] == word
    own = summary(results, "adadelta")
    assert own.accuracy.value == pytest.approx(
        0.9745
    )  # seeds 10 to 19 add 0 to .009, the middle six of them .0045 on average
    assert own.failed.value == 0.0
    assert summary(results, "sgd").failed.value == 1.0
    # .97 + at the last of 4 epochs is the first at .95; 2 sizes of 36 clouds are 3 batches of 24.
    assert updates_to_target(results, "adadelta") == [12.0] * 10
    tables = [maker(results) for maker in (study_tables.arms_table, study_tables.against_table)]
    assert [len(table.rows) for table in tables if table is not None] == [10, 8]
    assert "nan" not in "".join(table.to_text() for table in tables if table is not None)
    drawing = study_figures.curves(results)
    assert drawing is not None
    assert len(drawing.figure.axes) == 2
    assert study_figures.profiles({"a": results, "b": results}) is not None


def test_a_part_without_final_runs_has_no_verdict(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(study, "finished", lambda part, **place: worked_off(part, stages=(SEARCH,)))
    path = study_results.fold(PART, size="quick", runs=tmp_path, out=tmp_path, allow_dirty=True)
    results = Results(read_json(path))
    assert verdict(results)[0] == rules.CANNOT_BE
    assert study_tables.arms_table(results) is None
    assert study_figures.curves(results) is not None  # the best of n trials is there
    monkeypatch.setattr(study, "finished", lambda part, **place: {})
    with pytest.raises(CollectError, match="no stage of any arm"):
        study_results.fold(PART, size="quick", runs=tmp_path, out=tmp_path)


def test_runner_works_a_part_off_and_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    """Real processes, made-up training: one seed fails first, and the next call does what is missing and nothing else."""
    small = replace(
        PARTS[PART], module="tests.experiments.made_up", optimizers=("adadelta",), trials=2, confirm=(), final=(10,)
    )
    monkeypatch.setattr(study, "PARTS", {PART: small})
    monkeypatch.setattr(study_results, "PARTS", {PART: small})
    (tmp_path / "broken").write_text("10")
    cores = study.usable_cores()[:1]
    first = study.Runner(PART, size="smoke", out=tmp_path, cores=cores)
    assert not first.run()
    assert sorted(job.arm for job in first.failed) == ["adadelta", PAPER_WAY]
    told = capsys.readouterr().out
    assert "job 1 of 4" in told
    assert "min left" in told
    assert "failed, see" in told
    logs = list((tmp_path / "study_standard_nofit" / "logs").glob("*seed_10.txt"))
    assert all("this job is broken" in log.read_text() for log in logs)
    stamps = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("run.json")}
    (tmp_path / "broken").unlink()
    assert study.Runner(PART, size="smoke", out=tmp_path, cores=cores).run()
    assert len(list(tmp_path.rglob("run.json"))) == 4
    assert all(path.stat().st_mtime_ns == stamp for path, stamp in stamps.items())
    path = study_results.fold(PART, size="smoke", runs=tmp_path, out=tmp_path, allow_dirty=True)
    assert [row["stage"] for row in read_json(path)["runs"]] == [SEARCH, SEARCH, FINAL, FINAL]
    assert "standard_nofit         4     4" in study.listing([PART], size="smoke", out=tmp_path, processes=1)
