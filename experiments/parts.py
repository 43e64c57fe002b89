"""Train the network that labels the points of a scan by part, for `cablejax measure --checkpoint`.

python -m experiments.parts
"""

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from flax import nnx

from cablejax.io import RunLogger
from cablejax.nets import PartNetwork
from cablejax.simulate import PARTS, PartsConfig, PartSplit, make_part_split
from cablejax.train import Metrics, evaluate, fit, intersection_over_union
from experiments.harness import app
from experiments.harness.schema import Config
from experiments.material.training import training_config

DENSER = 2  # times the points of a cloud are simulated for training, of which each epoch draws its own
SCALES = (0.85, 1.15)
AUGMENTED_STREAM = 11  # apart from the streams of the simulator


def clouds(cfg: Config, split: str, *, denser: int = 1) -> PartSplit:
    """Labelled clouds of a split."""
    n_points, ball_mm, mix = denser * cfg.parts.n_points, cfg.parts.ball_mm, cfg.parts.mix
    config = PartsConfig(n_points=n_points, ball_mm=ball_mm, mix=mix, seed=cfg.dataset.seed)
    return make_part_split(config, split, getattr(cfg.parts, split), progress=True)


def training_clouds(cfg: Config) -> Callable[[int], PartSplit]:
    """The training clouds of an epoch: a sample of each one's points, at another scale, mirrored or not."""
    whole = [np.asarray(each) for each in clouds(cfg, "train", denser=DENSER)]
    count, n = whole[1].shape

    def epoch_clouds(epoch: int) -> PartSplit:
        rng = np.random.default_rng((cfg.dataset.seed, AUGMENTED_STREAM, epoch))
        luck = np.where(whole[1], rng.random((count, n)), 2.0)  # padding comes last
        rows = np.argpartition(luck, cfg.parts.n_points, axis=1)[:, : cfg.parts.n_points]
        xyz = np.take_along_axis(whole[0], rows[..., None], axis=1)
        mask, label = (np.take_along_axis(each, rows, axis=1) for each in whole[1:])
        scale = rng.uniform(*SCALES, (count, 1, 1)) * [1.0, 1.0, 1.0]
        scale[:, :, 2] *= rng.choice([-1.0, 1.0], (count, 1))
        return PartSplit((xyz * scale).astype(np.float32), mask, label)  # pyright: ignore[reportArgumentType]

    return epoch_clouds


def scores(found: Metrics) -> dict[str, Any]:
    """Shares of the points that are labelled rightly, and intersection over union, of every part and of all."""
    each = intersection_over_union(found.confusion)
    count = found.confusion.sum(axis=1)
    recall = np.divide(np.diag(found.confusion), count, out=np.full(len(count), np.nan), where=count > 0)
    return {
        "overall": found.overall,
        "class_average": found.class_average,
        "mean_iou": float(np.nanmean(each)),
        "iou": dict(zip(PARTS, each.tolist(), strict=True)),
        "recall": dict(zip(PARTS, recall.tolist(), strict=True)),
        "confusion": found.confusion.tolist(),
    }


def run(cfg: Config, folder: Path) -> dict[str, Any]:
    """Train, choose the epoch on validation, and touch the test split once."""
    model = PartNetwork(len(PARTS), rngs=nnx.Rngs(cfg.seed), **cfg.model.options)
    with RunLogger(folder / "tensorboard") as log:
        validation = clouds(cfg, "validation")
        result = fit(model, training_clouds(cfg), validation, training_config(cfg), folder=folder, logger=log)
    best = result.history[result.best_epoch - 1]
    return {
        "parts": list(PARTS),
        "history": [asdict(epoch) for epoch in result.history],
        "best_epoch": result.best_epoch,
        "validation_overall": best.validation_overall,
        "compile_seconds": result.compile_seconds,
        "train_seconds": result.seconds,
        **{f"test_{name}": value for name, value in scores(evaluate(result.model, clouds(cfg, "test"))).items()},
    }


def headline(metrics: dict[str, Any]) -> str:
    return (
        f"points labelled rightly: validation {metrics['validation_overall']:.3f} (epoch {metrics['best_epoch']}), "
        f"test {metrics['test_overall']:.3f}, mean IoU {metrics['test_mean_iou']:.3f}"
    )


if __name__ == "__main__":
    app.main(run, experiment="parts", headline=headline)
