"""Train one network under one optimizer: Figures 5-13 are sweeps of this.

python -m experiments.train model=adgcnn optimizer=adadelta
python -m experiments.train -m experiment=fig13_optimizers
"""

from collections.abc import Callable
from dataclasses import asdict, fields
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx

from cablejax.io import RunLogger
from cablejax.nets import build_model
from cablejax.ops import adaptive_filter, statistical_outliers
from cablejax.simulate import DatasetConfig, Split, make_split, sample_clouds
from cablejax.train import Metrics, TrainConfig, TrainingDiverged, TrainResult, evaluate, fit, initialise_from
from cablejax.types import PointCloud
from experiments import app
from experiments.baseline import baseline
from experiments.schema import Config, TrainingConfig
from experiments.schema import DatasetConfig as DatasetSchema

FRESH_STREAM = 7  # apart from the streams of the fixed splits
FILTER_K = 16  # neighbours of the filter on clouds of a few hundred points


@partial(jax.jit, static_argnames=("k",))
def _cleaned(xyz: jax.Array, mask: jax.Array, *, k: int = FILTER_K) -> tuple[jax.Array, jax.Array]:
    """Outlier removal and the order-2 adaptive filter, one cloud after the other."""

    def clean(cloud: PointCloud) -> PointCloud:
        keep = statistical_outliers(cloud, k=k).keep
        return PointCloud(adaptive_filter(PointCloud(cloud.xyz, keep), k=k, order=2).xyz, keep)

    return tuple(jax.lax.map(clean, PointCloud(xyz, mask)))


def filtered(split: Split) -> Split:
    """A split whose clouds have been cleaned; points removed are masked."""
    xyz, mask = _cleaned(jnp.asarray(split.xyz), jnp.asarray(split.mask))
    return split._replace(xyz=np.asarray(xyz), mask=np.asarray(mask))


def clouds_of(config: DatasetSchema, per_class: int) -> DatasetConfig:
    """The simulator's settings for a split with so many clouds of each class."""
    return DatasetConfig(
        sizes_mm2=tuple(config.sizes_mm2),
        n_points=config.n_points,
        clouds_per_class=per_class,
        version=config.version,
        canonical_pose=config.canonical_pose,
        seed=config.seed,
    )


@lru_cache(maxsize=6)
def _split(config: DatasetConfig, name: str, clean: bool) -> Split:
    return filtered(make_split(config, name)) if clean else make_split(config, name)


def training_clouds(config: DatasetSchema) -> Split | Callable[[int], Split]:
    """The fixed training split, or with `dataset.fresh` a function that simulates new clouds for each epoch."""
    settings = clouds_of(config, config.train_per_class)
    if not config.fresh:
        return _split(settings, "train", config.filtered)
    root = jax.random.fold_in(jax.random.key(config.seed), FRESH_STREAM)
    total = config.train_per_class * len(config.sizes_mm2)

    def fresh(epoch: int) -> Split:
        split = sample_clouds(settings, total, key=jax.random.fold_in(root, epoch))
        return filtered(split) if config.filtered else split

    return fresh


def training_config(cfg: Config) -> TrainConfig:
    """The engine's settings."""
    shared = {each.name for each in fields(TrainConfig)} & {each.name for each in fields(TrainingConfig)}
    chosen = {name: getattr(cfg.training, name) for name in shared - {"frozen"}}
    return TrainConfig(
        optimizer=cfg.optimizer.name,
        learning_rate=cfg.optimizer.learning_rate,
        optimizer_options=dict(cfg.optimizer.options),
        seed=cfg.seed,
        frozen=tuple(cfg.training.frozen),
        **chosen,
    )


def fitted_options(cfg: Config) -> dict[str, Any]:
    """What a network that fits a cylinder is built with beside its options: what the sizes measure."""
    return {"diameters_mm": list(clouds_of(cfg.dataset, 1).diameters_mm)} if cfg.model.name == "adgcnn_fit" else {}


def initial_model(cfg: Config, classes: int) -> nnx.Module:
    """The network with fresh weights, or with `training.init_from` those of another run where they fit."""
    options = {**cfg.model.options, **fitted_options(cfg)}
    model = build_model(cfg.model.name, classes, rngs=nnx.Rngs(cfg.seed), **options)
    if cfg.training.init_from is None:
        return model
    started = initialise_from(model, cfg.training.init_from)
    print(f"from {cfg.training.init_from}; fresh: {', '.join(started.kept) or 'nothing'}")
    return started.model


def held_out(cfg: Config, name: str) -> Split:
    """The validation or the test split of a configuration."""
    per_class = cfg.dataset.validation_per_class if name == "validation" else cfg.dataset.test_per_class
    return _split(clouds_of(cfg.dataset, per_class), name, cfg.dataset.filtered)


def fitted(cfg: Config, folder: Path, log: RunLogger | None = None) -> TrainResult:
    """Train the configured network, or go on from what a killed run left in the folder."""
    classes = len(cfg.dataset.sizes_mm2)
    model = initial_model(cfg, classes)
    validation = held_out(cfg, "validation")
    return fit(model, training_clouds(cfg.dataset), validation, training_config(cfg), folder=folder, logger=log)


def run(cfg: Config, folder: Path) -> dict[str, Any]:
    """Train, choose the epoch on validation, and touch the test split once, or not at all while tuning."""
    labels = [f"{size:g}" for size in cfg.dataset.sizes_mm2]
    with RunLogger(folder / "tensorboard") as log:
        try:
            result = fitted(cfg, folder, log)
        except TrainingDiverged as error:
            if not cfg.training.keep_diverged:
                raise
            return diverged(cfg, error)
        metrics = outcome(cfg, result)
        if cfg.training.test:
            split = held_out(cfg, "test")
            test = evaluate(result.model, split)
            _log_outcome(log, cfg, test, split, labels)
            metrics |= {
                "test_overall": test.overall,
                "test_class_average": test.class_average,
                "test_loss": test.loss,
                "test_confusion": test.confusion.tolist(),
                **baseline(split, clouds_of(cfg.dataset, 1).diameters_mm),
                **({} if test.diameter is None else {f"test_{k}": v for k, v in test.diameter._asdict().items()}),
            }
    return metrics | {"labels_mm2": labels}


def outcome(cfg: Config, result: TrainResult) -> dict[str, Any]:
    """What training and validation say of a run."""
    best = result.history[result.best_epoch - 1]
    return {
        "learning_rate": cfg.optimizer.learning_rate,
        "history": [asdict(epoch) for epoch in result.history],
        "best_epoch": result.best_epoch,
        "validation_overall": best.validation_overall,
        "compile_seconds": result.compile_seconds,
        "train_seconds": result.seconds,
    }


def diverged(cfg: Config, error: TrainingDiverged) -> dict[str, Any]:
    """A run whose loss was no number, in a study of learning rates an outcome like another: nothing is classified."""
    nothing = {"validation_overall": 0.0, "test_overall": 0.0, "test_class_average": 0.0}
    return nothing | {"learning_rate": cfg.optimizer.learning_rate, "history": [], "error": str(error)}


def _log_outcome(log: RunLogger, cfg: Config, test: Metrics, split: Split, labels: list[str]) -> None:
    """What TensorBoard shows beside the curves: settings with their outcome, confusions, one cloud."""
    settings = {"model": cfg.model.name, "optimizer": cfg.optimizer.name, "learning_rate": cfg.optimizer.learning_rate}
    log.hparams(settings | {"seed": cfg.seed}, {"test/overall": test.overall, "test/class_average": test.class_average})
    log.confusion("test/confusion", test.confusion, labels, cfg.training.epochs)
    log.mesh("test/first_cloud", split.xyz[0], 0)


def headline(metrics: dict[str, Any]) -> str:
    if not metrics["history"]:
        return f"rate {metrics['learning_rate']:g}: {metrics['error']}"
    text = f"rate {metrics['learning_rate']:g}, loss {metrics['history'][-1]['train_loss']:.3f}, "
    text += f"validation accuracy {metrics['validation_overall']:.3f} (best epoch {metrics['best_epoch']})"
    if "test_overall" not in metrics:
        return text
    return text + f", test {metrics['test_overall']:.3f} (a cylinder fit: {metrics['baseline_overall']:.3f})"


if __name__ == "__main__":
    app.main(run, experiment="train", headline=headline, objective=lambda metrics: metrics["validation_overall"])
