"""Train one network under one optimizer: Figures 5-13 are sweeps of this.

python -m experiments.train model=adgcnn optimizer=adadelta
python -m experiments.train -m experiment=fig13_optimizers
"""

from collections.abc import Callable
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path
from typing import Any

import jax
from flax import nnx

from cablejax.io import RunLogger
from cablejax.nets import build_model
from cablejax.simulate import DatasetConfig, Split, make_split, sample_clouds
from cablejax.train import Metrics, TrainConfig, evaluate, fit, initialise_from
from experiments import app
from experiments.schema import Config
from experiments.schema import DatasetConfig as DatasetSchema

FRESH_STREAM = 7  # apart from the streams of the fixed splits


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
def _split(config: DatasetConfig, name: str) -> Split:
    return make_split(config, name)


def training_clouds(config: DatasetSchema) -> Split | Callable[[int], Split]:
    """The fixed training split, or with `dataset.fresh` a function that simulates new clouds for each epoch."""
    settings = clouds_of(config, config.train_per_class)
    if not config.fresh:
        return _split(settings, "train")
    root = jax.random.fold_in(jax.random.key(config.seed), FRESH_STREAM)
    total = config.train_per_class * len(config.sizes_mm2)
    return lambda epoch: sample_clouds(settings, total, key=jax.random.fold_in(root, epoch))


def training_config(cfg: Config) -> TrainConfig:
    """The engine's settings; the epoch is chosen on validation."""
    return TrainConfig(
        optimizer=cfg.optimizer.name,
        learning_rate=cfg.optimizer.learning_rate,
        optimizer_options=dict(cfg.optimizer.options),
        epochs=cfg.training.epochs,
        batch_size=cfg.training.batch_size,
        label_smoothing=cfg.training.label_smoothing,
        seed=cfg.seed,
        keep_best=True,
        frozen=tuple(cfg.training.frozen),
        precision=cfg.training.precision,
    )


def initial_model(cfg: Config, classes: int) -> nnx.Module:
    """The network with fresh weights, or with `training.init_from` those of another run where they fit."""
    model = build_model(cfg.model.name, classes, rngs=nnx.Rngs(cfg.seed), **cfg.model.options)
    if cfg.training.init_from is None:
        return model
    started = initialise_from(model, cfg.training.init_from)
    print(f"from {cfg.training.init_from}; fresh: {', '.join(started.kept) or 'nothing'}")
    return started.model


def run(cfg: Config, folder: Path) -> dict[str, Any]:
    """Train, choose the epoch on validation, touch the test split once."""
    labels = [f"{size:g}" for size in cfg.dataset.sizes_mm2]
    validation = _split(clouds_of(cfg.dataset, cfg.dataset.validation_per_class), "validation")
    model = initial_model(cfg, len(labels))
    with RunLogger(folder / "tensorboard") as log:
        result = fit(model, training_clouds(cfg.dataset), validation, training_config(cfg), folder=folder, logger=log)
        test_split = _split(clouds_of(cfg.dataset, cfg.dataset.test_per_class), "test")
        test = evaluate(result.model, test_split)
        _log_outcome(log, cfg, test, test_split, labels)
    return {
        "history": [asdict(epoch) for epoch in result.history],
        "best_epoch": result.best_epoch,
        "test_overall": test.overall,
        "test_class_average": test.class_average,
        "test_loss": test.loss,
        "test_confusion": test.confusion.tolist(),
        "labels_mm2": labels,
        "compile_seconds": result.compile_seconds,
        "train_seconds": result.seconds,
    }


def _log_outcome(log: RunLogger, cfg: Config, test: Metrics, split: Split, labels: list[str]) -> None:
    """What TensorBoard shows beside the curves: settings with their outcome, confusions, one cloud."""
    settings = {"model": cfg.model.name, "optimizer": cfg.optimizer.name, "learning_rate": cfg.optimizer.learning_rate}
    log.hparams(settings | {"seed": cfg.seed}, {"test/overall": test.overall, "test/class_average": test.class_average})
    log.confusion("test/confusion", test.confusion, labels, cfg.training.epochs)
    log.mesh("test/first_cloud", split.xyz[0], 0)


def headline(metrics: dict[str, Any]) -> str:
    last = metrics["history"][-1]
    return (
        f"loss {last['train_loss']:.3f}, test accuracy {metrics['test_overall']:.3f} "
        f"(best epoch {metrics['best_epoch']} on validation)"
    )


if __name__ == "__main__":
    app.main(run, experiment="train", headline=headline)
