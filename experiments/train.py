"""Train one network under one optimizer: Figures 5-13 are sweeps of this.

python -m experiments.train model=adgcnn optimizer=adadelta
python -m experiments.train -m experiment=fig13_optimizers
"""

from dataclasses import asdict
from pathlib import Path
from typing import Any

from flax import nnx

from cablejax.nets import build_model
from cablejax.simulate import DatasetConfig, Split, make_split
from cablejax.train import TrainConfig, evaluate, fit
from experiments import app
from experiments.schema import Config
from experiments.schema import DatasetConfig as DatasetSchema


def make_splits(config: DatasetSchema) -> dict[str, Split]:
    """The train, validation and test clouds, disjoint by construction."""
    counts = {
        "train": config.train_per_class,
        "validation": config.validation_per_class,
        "test": config.test_per_class,
    }
    return {
        split: make_split(
            DatasetConfig(
                sizes_mm2=tuple(config.sizes_mm2),
                n_points=config.n_points,
                clouds_per_class=count,
                version=config.version,
                canonical_pose=config.canonical_pose,
                seed=config.seed,
            ),
            split,
        )
        for split, count in counts.items()
    }


def run(cfg: Config, folder: Path) -> dict[str, Any]:
    """Train, choose the epoch on validation, touch the test split once."""
    splits = make_splits(cfg.dataset)
    model = build_model(cfg.model.name, len(cfg.dataset.sizes_mm2), rngs=nnx.Rngs(cfg.seed), **cfg.model.options)
    config = TrainConfig(
        optimizer=cfg.optimizer.name,
        learning_rate=cfg.optimizer.learning_rate,
        optimizer_options=dict(cfg.optimizer.options),
        epochs=cfg.training.epochs,
        batch_size=cfg.training.batch_size,
        label_smoothing=cfg.training.label_smoothing,
        seed=cfg.seed,
    )
    result = fit(model, splits["train"], splits["validation"], config, folder=folder)
    test = evaluate(result.model, splits["test"])
    return {
        "history": [asdict(epoch) if not isinstance(epoch, dict) else epoch for epoch in result.history],
        "best_epoch": result.best_epoch,
        "test_overall": test.overall,
        "test_class_average": test.class_average,
        "test_confusion": test.confusion.tolist(),
        "labels_mm2": list(cfg.dataset.sizes_mm2),
        "compile_seconds": result.compile_seconds,
    }


def headline(metrics: dict[str, Any]) -> str:
    last = metrics["history"][-1]
    return (
        f"loss {last['train_loss']:.3f}, test accuracy {metrics['test_overall']:.3f} "
        f"(best epoch {metrics['best_epoch']} on validation)"
    )


if __name__ == "__main__":
    app.main(run, experiment="train", headline=headline)
