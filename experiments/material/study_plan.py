"""The study's parts, arms and jobs, and which of them the finished ones allow: docs/study.md as code."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from experiments.harness import tuning
from experiments.harness.app import composed
from experiments.harness.schema import Config

OPTIMIZERS = ("adadelta", "sgd", "mbgd", "adagrad", "rmsprop", "adam", "adamw", "schedule_free", "muon")
PAPERS = ("adadelta", "sgd", "mbgd", "adagrad", "rmsprop")
SEARCH, CONFIRM, FINAL = "search", "confirm", "final"
PAPER_WAY = "adadelta_paper"  # rate 1, no warm-up, no clipping, a constant rate; not tuned
CONFIRMED = 2  # trials that go on to the confirm stage
EPOCHS = 16


class Arm(NamedTuple):
    """What is compared within a part.

    Attributes:
        overrides: What sets it apart from its part.
        tuned: Whether there are trials; the final runs of one that is not have trial 0.
    """

    overrides: tuple[str, ...]
    tuned: bool = True


def optimizers(*names: str) -> dict[str, Arm]:
    """Arms by optimizer, and the paper's way."""
    arms = {name: Arm(("rates=search", f"optimizer={name}")) for name in names}
    if "schedule_free" in arms:
        arms["schedule_free"] = Arm((*arms["schedule_free"].overrides, "training.schedule=constant"))
    if "adadelta" in arms:
        own = ("training.warmup_epochs=0", "training.clip_norm=null", "training.schedule=constant")
        arms[PAPER_WAY] = Arm(("optimizer=adadelta", "rates=stated", *own), tuned=False)
    return arms


def under(optimizer: str, **own: tuple[str, ...]) -> dict[str, Arm]:
    """Arms that differ in something else, each at its own best rate of one optimizer."""
    return {name: Arm(("rates=trial", f"optimizer={optimizer}", *overrides)) for name, overrides in own.items()}


@dataclass(frozen=True)
class Part:
    """One workload with one arm of the answer in the input.

    Attributes:
        overrides: What sets it apart from conf/experiment/study.yaml.
        target: Validation accuracy whose first epoch is counted.
        minutes: Of a run at size=quick on one core, for the dry run where none is done yet.
        arms: By name; the others are compared with the first one.
        module: What trains.
        trials: Of the search stage.
        confirm: Seeds of the confirm stage.
        final: Seeds of the final stage.
        classes: For the loss of a guess; 3 sizes at size=smoke.
        unused: Modules that `module` imports and no run of this part calls.
    """

    overrides: tuple[str, ...]
    target: float
    minutes: float
    arms: dict[str, Arm]
    module: str = "experiments.train"
    trials: int = 8
    confirm: tuple[int, ...] = (1,)
    final: tuple[int, ...] = tuple(range(10, 18))
    classes: int = 13
    epochs: int = EPOCHS
    unused: tuple[str, ...] = ("cablejax.nets.baselines", "cablejax.nets.adgcnn_fit", "cablejax.nets.pretrained",
                               "cablejax.ops.filters", "cablejax.ops.outliers", "cablejax.train.transfer")  # fmt: skip


IMAGES = ("+model.options.size=[64,256]", "+model.options.extent_mm=256")
NO_FIT = ("dataset=standard", "variant=pose_none")
PARTS = {
    "standard_nofit": Part(NO_FIT, 0.95, 2.0, optimizers(*OPTIMIZERS)),
    "standard_fit": Part(("dataset=standard",), 0.95, 2.0, optimizers(*PAPERS, "adam")),
    "hard_nofit": Part(
        ("dataset=hard", "variant=pose_none", "dataset.n_points=512"), 0.5, 4.0, optimizers(*PAPERS, "adam")
    ),
    # 42 clouds of each of ten classes an epoch, pass after pass: 17 batches of 24, as in the other parts.
    "modelnet10": Part(
        ("dataset.train_per_class=42",),
        0.9,
        2.0,
        optimizers(*PAPERS, "adam"),
        module="experiments.pretrain",
        classes=10,
    ),
    # As many updates as the others take, each with the gradient of the whole epoch's clouds.
    "gradient_descent": Part(
        NO_FIT, 0.95, 30.0, optimizers("sgd"), trials=4, confirm=(), final=(10, 11, 12), epochs=17 * EPOCHS
    ),
    # Each part of the network removed.
    "ablation": Part(
        NO_FIT,
        0.95,
        1.6,
        under(
            "adadelta",
            full=(),
            no_attention=("model.options.attention=false",),
            no_enhancement=("model.options.enhancement=false",),
            no_fusion=("model.options.fusion=false",),
            no_raster=("model.options.enhancement=false", "model.options.fusion=false"),
        ),
    ),
    # As many updates on fewer clouds, over and over: 416, 832, 1,664, 3,328 and 6,656, of which the last is never repeated.
    "clouds": Part(
        NO_FIT,
        0.95,
        1.8,
        under("adadelta", fresh=(), **{f"pool{pool}": (f"dataset.pool={pool}",) for pool in (1, 2, 4, 8)}),
        confirm=(),
    ),
    # Networks on points that came before and after the paper, under Adam, which most of them were published with.
    "point_networks": Part(
        ("dataset=standard",),
        0.95,
        17.0,
        under(
            "adam",
            **{
                name: (f"model={name}", "+model.options.pose=none")
                for name in ("adgcnn", "dgcnn", "pointnet", "pointnet2", "pointnext")
            },
        ),
        trials=4,
        confirm=(),
        final=(10, 11, 12),
        unused=(),
    ),
    # Figures 5-12. Images of the whole cable at 1 mm a pixel, of 1,024 points; ADGCNN has the same points and no fit.
    "networks": Part(
        ("dataset=standard", "dataset.n_points=1024"),
        0.95,
        30.0,
        under(
            "adadelta",
            adgcnn=("model=adgcnn", "+model.options.pose=none"),
            **{name: (f"model={name}", *IMAGES) for name in ("alexnet", "vgg16", "resnet50")},
        ),
        confirm=(),
        final=tuple(range(10, 17)),
        unused=(),
    ),
}


class Job(NamedTuple):
    """One run."""

    stage: str
    arm: str
    trial: int
    seed: int

    @property
    def label(self) -> str:
        return f"{self.stage} {self.arm} trial {self.trial} seed {self.seed}"


Records = dict[Job, dict[str, Any]]


def name_of(part: str) -> str:
    """The experiment's name of a part, which is that of its results file."""
    return f"study_{part}"


def overrides(part: str, job: Job, *, size: str) -> list[str]:
    """The command line of a job after `python -m <module>`."""
    this = PARTS[part]
    epochs = 2 if size == "smoke" else this.epochs
    classes = 3 if size == "smoke" and this.module == "experiments.train" else this.classes
    found = [
        "experiment=study", f"name={name_of(part)}", f"size={size}", *this.overrides, f"training.epochs={epochs}",
        *this.arms[job.arm].overrides, f"seed={job.seed}", f"dataset.seed={job.seed}", f"trial={job.trial}",
        f"training.test={str(job.stage == FINAL).lower()}",
    ]  # fmt: skip
    if job.stage != FINAL:  # a trial that is still guessing after a quarter of its epochs
        found += [
            f"training.give_up_epoch={max(1, epochs // 4)}",
            f"training.give_up_loss={0.9 * math.log(classes):.4g}",
        ]
    return found


@cache
def _composed(part: str, stage: str, arm: str, size: str) -> Config:
    return composed(*overrides(part, Job(stage, arm, 0, 0), size=size))


def config_of(part: str, job: Job, *, size: str) -> Config:
    """The configuration that `overrides` compose to, composed once for all trials and seeds of an arm."""
    cfg = _composed(part, job.stage, job.arm, size)
    optimizer = cfg.optimizer
    if cfg.rates in ("search", "trial"):
        rate = tuning.trial_rate(optimizer.lowest_rate, optimizer.highest_rate, job.trial)
        options = tuning.trial_options(optimizer.name, job.trial) if cfg.rates == "search" else optimizer.options
        optimizer = replace(optimizer, learning_rate=rate, options=options)
    return replace(
        cfg, seed=job.seed, trial=job.trial, dataset=replace(cfg.dataset, seed=job.seed), optimizer=optimizer
    )


def score(records: Iterable[dict[str, Any]]) -> tuple[float, float]:
    """What runs are ranked by: the mean of their best validation accuracies, of equals the lower loss."""
    rows = [record["metrics"] for record in records]
    loss = [row["history"][row["best_epoch"] - 1]["validation_loss"] if row["history"] else math.inf for row in rows]
    return float(np.mean([row["validation_overall"] for row in rows])), -float(np.mean(loss))


def confirmed(part: str, arm: str, done: Records) -> list[int] | None:
    """The trials that go to the confirm stage, the best first; None as long as the search is not complete."""
    trials = range(PARTS[part].trials)
    found = {trial: done.get(Job(SEARCH, arm, trial, 0)) for trial in trials}
    there = {trial: record for trial, record in found.items() if record is not None}
    if len(there) < len(trials):
        return None
    return sorted(there, key=lambda trial: score([there[trial]]), reverse=True)[:CONFIRMED]


def chosen(part: str, arm: str, done: Records) -> int | None:
    """The trial that goes to the final stage; None as long as search or confirm is not complete."""
    if not PARTS[part].arms[arm].tuned:
        return 0
    best = confirmed(part, arm, done)
    if best is None:
        return None
    seeds = [(SEARCH, 0), *((CONFIRM, seed) for seed in PARTS[part].confirm)]
    rows = {trial: [done.get(Job(stage, arm, trial, seed)) for stage, seed in seeds] for trial in best}
    whole = {trial: [each for each in found if each is not None] for trial, found in rows.items()}
    if any(len(found) < len(seeds) for found in whole.values()):
        return None
    return max(whole, key=lambda trial: score(whole[trial]))


def jobs(part: str, done: Records) -> list[Job]:
    """Every job that the finished ones allow, done or not: first those of the arms that the paper's claim is about.

    Of each of these two sets stage by stage, and final runs seed by seed, which are compared.
    """
    arms = PARTS[part].arms
    first = [arm for arm in arms if arm in (*PAPERS, PAPER_WAY)]
    return [job for some in (first, [arm for arm in arms if arm not in first]) for job in _jobs(part, some, done)]


def _jobs(part: str, arms: list[str], done: Records) -> list[Job]:
    this = PARTS[part]
    tuned = [arm for arm in arms if this.arms[arm].tuned]
    found = [Job(SEARCH, arm, trial, 0) for arm in tuned for trial in range(this.trials)]
    for arm in tuned:
        found += [Job(CONFIRM, arm, trial, seed) for trial in confirmed(part, arm, done) or [] for seed in this.confirm]
    trials = {arm: chosen(part, arm, done) for arm in arms}
    found += [Job(FINAL, arm, trial, seed) for seed in this.final for arm, trial in trials.items() if trial is not None]
    return found


def complete(part: str, done: Records) -> list[Job]:
    """The jobs of every stage that an arm has finished wholly."""
    this = PARTS[part]
    kept = []
    for arm in this.arms:
        best, trial = confirmed(part, arm, done), chosen(part, arm, done)
        if this.arms[arm].tuned and best is not None:
            kept += [Job(SEARCH, arm, each, 0) for each in range(this.trials)]
            if trial is not None:
                kept += [Job(CONFIRM, arm, each, seed) for each in best for seed in this.confirm]
        if trial is not None:
            final = [Job(FINAL, arm, trial, seed) for seed in this.final]
            kept += final if all(job in done for job in final) else []
    return kept


def count(part: str) -> int:
    """Jobs of a part, those included that are not known yet."""
    this = PARTS[part]
    tuning_jobs = this.trials + min(CONFIRMED, this.trials) * len(this.confirm)
    return sum(arm.tuned * tuning_jobs + len(this.final) for arm in this.arms.values())
