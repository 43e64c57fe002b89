"""The study's path from search to verdict on made-up training: who goes on, what is kept, what is said, what is run again."""

import json
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from cablejax.io import read_json
from experiments import study, study_results
from experiments.analysis import rules
from experiments.analysis.results import Results
from experiments.analysis.study_summary import summary, updates_to_target, verdict
from experiments.collect import CollectError
from experiments.display.optimizers import study_figures, study_tables
from experiments.harness import run_log
from experiments.harness.app import composed
from experiments.harness.schema import Config
from experiments.material import study_plan
from experiments.material.study_plan import CONFIRM, FINAL, PAPER_WAY, PARTS, SEARCH, Job, Records
from tests.experiments import made_up

PART = "standard_nofit"


def record(job: Job) -> dict[str, Any]:
    metrics = made_up.metrics(job.arm, job.trial, job.seed, test=job.stage == FINAL)
    return {**job._asdict(), "options": {"rho": 0.9}, "seconds": 90.0, "cpu_seconds": 60.0, "metrics": metrics,
            "revision": "abc", "origin": "here"}  # fmt: skip


def worked_off(part: str = PART, *, stages: tuple[str, ...] = (SEARCH, CONFIRM, FINAL)) -> Records:
    """A part whose jobs are done as far as these stages."""
    done: Records = {}
    while left := [job for job in study_plan.jobs(part, done) if job not in done and job.stage in stages]:
        done |= {job: record(job) for job in left}
    return done


def folded(folder: Path, part: str = PART, *, arms: tuple[str, ...] = (), **stages: Any) -> Path:
    """The results file of a part that is worked off, or some arms of it."""
    done = {job: each for job, each in worked_off(part, **stages).items() if not arms or job.arm in arms}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(study, "finished", lambda part, **place: done)
        patch.setattr(run_log, "origins", lambda log: {"origins": {"here": {}}})
        return study_results.fold(part, size="quick", log=folder, out=folder)


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Results:
    return Results(read_json(folded(tmp_path_factory.mktemp("results"))))


@pytest.mark.parametrize(("part", "size"), [*((part, "quick") for part in PARTS), (PART, "smoke")])
def test_every_job_is_what_its_command_line_composes_to(part: str, size: str):
    done = worked_off(part)
    assert len(done) == study_plan.count(part)
    of_kind = {(job.arm, job.stage): job for job in done}
    others = {(arm, SEARCH) for arm in PARTS[part].arms if arm not in study_plan.OPTIMIZERS and arm != PAPER_WAY}
    wanted = {("adadelta", SEARCH), ("schedule_free", CONFIRM), (PAPER_WAY, FINAL), ("sgd", FINAL)} & set(
        of_kind
    ) | others
    for job in (of_kind[each] for each in wanted):
        config = study_plan.config_of(part, job, size=size)
        assert config == composed(*study_plan.overrides(part, job, size=size))
        assert config.dataset.seed == config.seed == job.seed
        assert config.dataset.fresh
        assert config.training.test == (job.stage == FINAL)
        assert (config.training.give_up_epoch is None) == (job.stage == FINAL)
        paper_way = job.arm == PAPER_WAY
        assert (config.training.warmup_epochs, config.training.clip_norm) == ((0, None) if paper_way else (1, 1))
        assert (config.training.schedule == "constant") == (paper_way or job.arm == "schedule_free")
        no_fit = part not in ("standard_fit", "modelnet10")  # of ModelNet10 `experiments.pretrain` takes the fit away
        if config.model.name == "adgcnn":
            assert (config.model.options.get("pose") == "none") == no_fit
            assert part == "ablation" or config.model.options["enhancement"]
            assert part == "ablation" or config.model.options["fusion"]


def test_the_arms_of_the_papers_claim_are_finished_before_others_begin():
    done: Records = {}
    order: list[Job] = []
    while left := [job for job in study_plan.jobs(PART, done) if job not in done]:
        done[left[0]] = record(left[0])
        order.append(left[0])
    theirs = [job.arm in (*study_plan.PAPERS, PAPER_WAY) for job in order]
    assert theirs == sorted(theirs, reverse=True)
    assert sum(theirs) == 5 * (8 + 2) + 6 * 8
    stages = [job.stage for job in order[: sum(theirs)]]
    assert stages == sorted(stages, key=(SEARCH, CONFIRM, FINAL).index)


def test_jobs_differ_in_their_digests():
    digests = {run_log.config_digest(study_plan.config_of(PART, job, size="quick")) for job in worked_off()}
    assert len(digests) == study_plan.count(PART)


@pytest.mark.parametrize("part", PARTS)
def test_stages_share_no_seed(part: str):
    seeds = [0, *PARTS[part].confirm, *PARTS[part].final]
    assert len(set(seeds)) == len(seeds)


def test_the_chosen_trial_is_the_best_over_search_and_confirm():
    """Trial 0 is best on the search's seed and not on the others: one lucky seed chooses nothing."""
    searched = worked_off(stages=(SEARCH,))
    assert (study_plan.confirmed(PART, "adam", searched) or [])[:2] == [0, made_up.BEST_TRIAL]
    assert study_plan.chosen(PART, "adam", searched) is None
    assert study_plan.chosen(PART, "adam", worked_off(stages=(SEARCH, CONFIRM))) == made_up.BEST_TRIAL
    assert {job.trial for job in worked_off() if job.stage == FINAL and job.arm == "adam"} == {made_up.BEST_TRIAL}


def test_only_whole_stages_are_folded():
    done = worked_off()
    assert len(study_plan.complete(PART, done)) == len(done)
    lost = next(job for job in done if job.stage == FINAL and job.arm == "muon")
    part_done = {job: each for job, each in done.items() if job != lost}
    kept = study_plan.complete(PART, part_done)
    assert len(kept) == len(done) - len(PARTS[PART].final)
    assert not any(job.stage == FINAL and job.arm == "muon" for job in kept)


def test_verdict_tables_and_figures_of_a_finished_part(results: Results):
    word, against = verdict(results)
    assert set(against) == {"sgd", "mbgd", "adagrad", "rmsprop"}
    assert word == rules.REPRODUCED  # .97 against .90 and .20, seed by seed
    assert study_tables.claim(results)[2] == word
    own = summary(results, "adadelta")
    assert own.accuracy.value == pytest.approx(
        0.9735
    )  # seeds 10 to 17 add 0 to .007, the middle four of them .0035 on average
    assert own.failed.value == 0.0
    assert summary(results, "sgd").failed.value == 1.0
    # .97 + at the last of 4 epochs is the first at .95; 13 sizes of 32 clouds are 17 batches of 24.
    assert updates_to_target(results, "adadelta") == [68.0] * 8
    tables = [maker(results) for maker in (study_tables.arms_table, study_tables.against_table)]
    assert [len(table.rows) for table in tables if table is not None] == [10, 8]
    assert "nan" not in "".join(table.to_text() for table in tables if table is not None)
    drawing = study_figures.curves(results)
    assert drawing is not None
    assert len(drawing.figure.axes) == 2
    assert study_figures.profiles({"a": results, "b": results}) is not None


@pytest.mark.parametrize(
    ("part", "rivals"),
    [("ablation", {"no_attention", "no_enhancement", "no_fusion"}), ("networks", {"alexnet", "vgg16", "resnet50"})],
)
def test_parts_that_compare_no_optimizers(part: str, rivals: set[str], tmp_path: Path):
    results = Results(read_json(folded(tmp_path, part)))
    word, against = verdict(results)
    assert set(against) == rivals
    # All arms but Adadelta's are alike in made-up training: differences of 0.
    assert word == rules.NOT_REPRODUCED
    stated, text, _ = study_tables.claim(results)
    assert stated in {study_tables.CLAIMS[f"study_{part}"]}
    assert "tuned alike" in text
    for table in (study_tables.arms_table(results), study_tables.against_table(results)):
        assert table is not None
        assert len(table.rows) in (len(PARTS[part].arms), len(PARTS[part].arms) - 1)
    assert study_figures.curves(results) is not None


def test_the_papers_arms_have_their_verdict_before_others_are_finished(tmp_path: Path, results: Results):
    alone = Results(read_json(folded(tmp_path, arms=(*study_plan.PAPERS, PAPER_WAY))))
    assert verdict(alone) == verdict(results)
    table = study_tables.arms_table(alone)
    assert table is not None
    assert len(table.rows) == 6
    assert study_figures.curves(alone) is not None


def test_a_part_without_final_runs_has_no_verdict(tmp_path: Path):
    results = Results(read_json(folded(tmp_path, stages=(SEARCH,))))
    assert verdict(results)[0] == rules.CANNOT_BE
    assert study_tables.arms_table(results) is None
    assert study_figures.curves(results) is not None  # the best of n trials is there
    with pytest.raises(CollectError, match="no stage of any arm"):
        study_results.fold(PART, size="quick", log=tmp_path / "empty", out=tmp_path)


class Training:
    """Made-up training in place of the real one, which counts what it is asked to do and can be broken for a seed."""

    def __init__(self):
        self.asked: list[tuple[int, int]] = []
        self.broken: int | None = None

    def measured(self, cfg: Config) -> dict[str, Any]:
        self.asked.append((cfg.trial, cfg.seed))
        if cfg.seed == self.broken:
            raise RuntimeError("this job is broken")
        arm = cfg.optimizer.name if cfg.rates == "search" else PAPER_WAY
        return made_up.metrics(arm, cfg.trial, cfg.seed, rate=cfg.optimizer.learning_rate, test=cfg.training.test)


@pytest.fixture
def training(monkeypatch: pytest.MonkeyPatch) -> Iterator[Training]:
    """A part of one optimizer with two trials and one final seed."""
    arms = {name: PARTS[PART].arms[name] for name in ("adadelta", PAPER_WAY)}
    small = replace(PARTS[PART], module="made_up_training", arms=arms, trials=2, confirm=(), final=(10,))
    monkeypatch.setitem(PARTS, PART, small)
    found = Training()
    monkeypatch.setitem(sys.modules, "made_up_training", found)  # pyright: ignore[reportArgumentType]
    monkeypatch.setattr(run_log, "present", lambda module, unused: {"a": "1"})
    monkeypatch.setattr(study, "present", lambda module, unused: {"a": "1"})
    run_log.origin.cache_clear()
    study_plan._composed.cache_clear()
    yield found
    run_log.origin.cache_clear()
    study_plan._composed.cache_clear()


def work(log: Path) -> bool:
    return study.work(PART, size="smoke", log=log)


def test_a_part_is_worked_off_and_gone_on_with(training: Training, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    """One seed fails first: the next call does what is missing and nothing else, and a third one nothing."""
    training.broken = 10
    assert not work(tmp_path)
    told = capsys.readouterr()
    assert "job 1 of 4" in told.out
    assert "min left" in told.out
    assert told.err.count("RuntimeError: this job is broken") == 2
    assert len(training.asked) == 4
    training.broken = None
    training.asked.clear()
    assert work(tmp_path)
    assert len(training.asked) == 2
    assert {seed for _, seed in training.asked} == {10}
    training.asked.clear()
    assert work(tmp_path)
    assert not training.asked
    path = study_results.fold(PART, size="smoke", log=tmp_path, out=tmp_path)
    assert [row["stage"] for row in read_json(path)["runs"]] == [SEARCH, SEARCH, FINAL, FINAL]
    assert "standard_nofit         4     4" in study.listing([PART], size="smoke", log=tmp_path)


def test_a_line_cut_off_by_a_kill_is_made_anew(training: Training, tmp_path: Path):
    assert work(tmp_path)
    file = tmp_path / f"{PART}.jsonl"
    rows = file.read_text().splitlines(keepends=True)
    file.write_text("".join(rows[:-1]) + rows[-1][:40])
    training.asked.clear()
    assert work(tmp_path)
    assert len(training.asked) == 1
    # The clock apart, the line is what it was.
    first, second = (json.loads(row) for row in (rows[-1], file.read_text().splitlines()[-1]))
    assert {**first, "seconds": 0, "cpu_seconds": 0} == {**second, "seconds": 0, "cpu_seconds": 0}
    file.write_text("{" + file.read_text())
    with pytest.raises(ValueError, match=r"standard_nofit\.jsonl: line 1 is no run"):
        work(tmp_path)


def test_other_sources_or_another_configuration_begin_anew(
    training: Training, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    assert work(tmp_path)
    rows = run_log.lines(tmp_path / f"{PART}.jsonl")
    monkeypatch.setattr(study, "present", lambda module, unused: {"a": "2"})
    assert not study.finished(PART, size="smoke", log=tmp_path)
    assert run_log.stale(tmp_path, rows, {"a": "2"}) == rows
    assert run_log.changed(tmp_path, rows[0], {"a": "2"}) == ["a"]
    run_log.accept(tmp_path, {"a": "2"}, run_log.combined({"a": "1"}), {"run": "made up"})
    assert len(study.finished(PART, size="smoke", log=tmp_path)) == 4
    assert not run_log.stale(tmp_path, rows, {"a": "2"})
    monkeypatch.setitem(PARTS, PART, replace(PARTS[PART], overrides=(*PARTS[PART].overrides, "training.batch_size=12")))
    study_plan._composed.cache_clear()
    assert not study.finished(PART, size="smoke", log=tmp_path)


def test_runs_are_taken_from_another_log_once(training: Training, tmp_path: Path):
    there, here = tmp_path / "there", tmp_path / "here"
    assert work(there)
    assert study_results.take(PART, log=here, other=there) == 4
    assert study_results.take(PART, log=here, other=there) == 0
    assert len(study.finished(PART, size="smoke", log=here)) == 4
    run_log.accept(there, {"a": "2"}, run_log.combined({"a": "1"}), {"run": "made up"})
    assert study_results.take(PART, log=here, other=there) == 0
    assert run_log.origins(here) == run_log.origins(there)


def test_metrics_survive_their_line():
    metrics = made_up.metrics("adam", 1, 10)
    kept = run_log.expanded(json.loads(json.dumps(run_log.compact(metrics))))
    assert kept["test_overall"] == pytest.approx(metrics["test_overall"], rel=1e-4)
    assert [epoch["epoch"] for epoch in kept["history"]] == [1, 2, 3, 4]
    assert kept["first_losses"] == [2.0, 1.9]
    for old, new in zip(metrics["history"], kept["history"], strict=True):
        assert new["validation_loss"] == pytest.approx(old["validation_loss"], rel=1e-4)
    assert run_log.expanded(run_log.compact({"history": [], "error": "diverged"}))["history"] == []


def test_the_place_of_a_run_does_not_count():
    cfg = study_plan.config_of(PART, Job(SEARCH, "adam", 0, 0), size="smoke")
    assert run_log.config_digest(cfg) == run_log.config_digest(replace(cfg, out="elsewhere", name="other"))
    assert run_log.config_digest(cfg) != run_log.config_digest(replace(cfg, seed=1))


def test_a_younger_key_counts_only_where_it_is_set(monkeypatch: pytest.MonkeyPatch):
    cfg = study_plan.config_of(PART, Job(SEARCH, "adam", 0, 0), size="smoke")
    before = run_log.config_digest(cfg)
    assert run_log.config_digest(replace(cfg, dataset=replace(cfg.dataset, pool=1))) != before
    monkeypatch.setattr(run_log, "ADDED", {"dataset": {}})
    assert run_log.config_digest(cfg) != before  # as a key of its own None would count
