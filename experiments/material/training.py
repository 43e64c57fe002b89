"""What a run of `experiments.train` is made of: its clouds, its network, its settings, and the training itself."""

from collections.abc import Callable
from dataclasses import fields
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
from cablejax.train import TrainConfig, TrainingDiverged, TrainResult, fit, initialise_from
from cablejax.types import PointCloud
from experiments.harness.schema import Config, TrainingConfig
from experiments.harness.schema import DatasetConfig as DatasetSchema
from experiments.material.baseline import baseline

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


@lru_cache(maxsize=16)
def fit_on_test(config: DatasetConfig, clean: bool) -> dict[str, float]:
    """What a plain fit makes of test clouds; worked out once for all runs of a process on the same ones."""
    return baseline(_split(config, "test", clean), config.diameters_mm)


@lru_cache(maxsize=64)
def _fresh(config: DatasetConfig, total: int, epoch: int, clean: bool) -> Split:
    """New clouds, the same for the same epoch; kept for the next run of a process on the same ones."""
    root = jax.random.fold_in(jax.random.key(config.seed), FRESH_STREAM)
    split = sample_clouds(config, total, key=jax.random.fold_in(root, epoch))
    return filtered(split) if clean else split


def training_clouds(config: DatasetSchema) -> Split | Callable[[int], Split]:
    """The fixed training split, or with `dataset.fresh` a function that simulates new clouds for each epoch of the pool."""
    settings = clouds_of(config, config.train_per_class)
    if not config.fresh:
        return _split(settings, "train", config.filtered)
    total = config.train_per_class * len(config.sizes_mm2)
    return lambda epoch: _fresh(settings, total, epoch % (config.pool or epoch + 1), config.filtered)


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


def fitted(cfg: Config, folder: Path | None, log: RunLogger | None = None) -> TrainResult:
    """Train the configured network, or go on from what a killed run left in the folder."""
    classes = len(cfg.dataset.sizes_mm2)
    model = initial_model(cfg, classes)
    validation = held_out(cfg, "validation")
    return fit(model, training_clouds(cfg.dataset), validation, training_config(cfg), folder=folder, logger=log)


def diverged(cfg: Config, error: TrainingDiverged) -> dict[str, Any]:
    """A run whose loss was no number, in a study of learning rates an outcome like another: nothing is classified."""
    nothing = {"validation_overall": 0.0, "test_overall": 0.0, "test_class_average": 0.0}
    return nothing | {"learning_rate": cfg.optimizer.learning_rate, "history": [], "error": str(error)}
