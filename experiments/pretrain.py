"""Train a network on ModelNet10's training clouds, to start cables from, or to see how it does on a public set.

python -m experiments.pretrain model=adgcnn optimizer=adadelta
python -m experiments.train model=adgcnn training.init_from=runs/pretrain/quick/... training.frozen=[layers]

Each cloud is centred and divided by its own radius, which cables never are; 10 % of it is kept for validation, and the
official test split is not touched.
"""

import os
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from flax import nnx

from cablejax.io import RunLogger
from cablejax.nets import build_model
from cablejax.simulate import Split
from cablejax.train import TrainingDiverged, evaluate, fit
from experiments import ROOT
from experiments.harness import app
from experiments.harness.schema import Config
from experiments.material.training import diverged, training_config

FILE = "classification/modelnet10_train_1024.npz"
RADIUS_MM = (
    60.0  # what a cloud's radius becomes: the networks' scale of 20 mm then spans -3 to 3, as it does for cables
)
VALIDATION_SHARE = 0.1


def modelnet(n_points: int, seed: int, *, held_out: int = 1) -> tuple[Split, list[Split], list[str]]:
    """Training clouds, so many held-out sets of a tenth each, drawn by class, and the names of the classes.

    Raises:
        ValueError: If the file is not there.
    """
    path = Path(os.environ.get("CABLEJAX_DATA", ROOT.parent / "shared" / "data")) / FILE
    if not path.is_file():
        raise ValueError(f"CABLEJAX_DATA: expected a folder with {FILE}, looked for {path}")
    with np.load(path) as file:
        xyz, label = file["xyz"][:, :n_points].astype(np.float32), file["label"].astype(np.int32)
        names = [str(each) for each in file["classes"]]
    xyz = xyz - xyz.mean(axis=1, keepdims=True)
    xyz = xyz * (RADIUS_MM / np.linalg.norm(xyz, axis=2).max(axis=1))[:, None, None]
    order = np.random.default_rng(seed).permutation(len(label))
    of_class = [
        (order[label[order] == c], int(VALIDATION_SHARE * np.sum(label == c))) for c in sorted(set(label.tolist()))
    ]
    held = [np.concatenate([rows[i * n : (i + 1) * n] for rows, n in of_class]) for i in range(held_out)]
    rest = np.setdiff1d(order, np.concatenate(held))
    return _split(xyz, label, rest), [_split(xyz, label, rows) for rows in held], names


def passing(train: Split, cfg: Config) -> Split | Callable[[int], Split]:
    """All training clouds in every epoch, or with `dataset.fresh` the next `dataset.train_per_class` a class, pass after pass."""
    if not cfg.dataset.fresh:
        return train
    labels, count = np.asarray(train.label), cfg.dataset.train_per_class

    def next_clouds(epoch: int) -> Split:
        rows = []
        for c in range(labels.max() + 1):
            own = np.flatnonzero(labels == c)
            place = np.arange(epoch * count, (epoch + 1) * count)
            order = {
                p: np.random.default_rng((cfg.seed, c, int(p))).permutation(own) for p in np.unique(place // len(own))
            }
            rows += [order[p][i] for p, i in zip(place // len(own), place % len(own), strict=True)]
        return _split(np.asarray(train.xyz), labels, np.asarray(rows))

    return next_clouds


def _split(xyz: np.ndarray, label: np.ndarray, rows: np.ndarray) -> Split:
    count = len(rows)
    return Split(xyz[rows], np.ones((count, xyz.shape[1]), bool), label[rows], np.zeros(count, np.float32))  # pyright: ignore[reportArgumentType]


def run(cfg: Config, folder: Path) -> dict[str, Any]:
    """Train in a folder: checkpoints to go on from, curves for TensorBoard."""
    with RunLogger(folder / "tensorboard") as log:
        return measured(cfg, folder, log)


def measured(cfg: Config, folder: Path | None = None, log: RunLogger | None = None) -> dict[str, Any]:
    """Train, choose the epoch on validation; with `training.test` another tenth of the training clouds tests it.

    Args:
        cfg: The whole configuration.
        folder: Where a killed run is gone on with; None keeps nothing.
        log: Where curves go; None draws none.
    """
    train, held, names = modelnet(cfg.dataset.n_points, cfg.seed, held_out=2)
    validation = held[0]
    if not cfg.training.test:  # what is not tested on is trained on
        train, (validation,), _ = modelnet(cfg.dataset.n_points, cfg.seed)
    options = {**cfg.model.options, **({"pose": "none"} if cfg.model.name in ("adgcnn", "dgcnn", "pointnet") else {})}
    model = build_model(cfg.model.name, len(names), rngs=nnx.Rngs(cfg.seed), **options)
    try:
        result = fit(model, passing(train, cfg), validation, training_config(cfg), folder=folder, logger=log)
    except TrainingDiverged as error:
        if not cfg.training.keep_diverged:
            raise
        return diverged(cfg, error)
    test = evaluate(result.model, held[1]) if cfg.training.test else None
    best = result.history[result.best_epoch - 1]
    return {
        "learning_rate": cfg.optimizer.learning_rate,
        "history": [asdict(epoch) for epoch in result.history],
        "best_epoch": result.best_epoch,
        "validation_overall": best.validation_overall,
        "validation_class_average": best.validation_class_average,
        "classes": names,
        "train_clouds": len(train.label),
        "validation_clouds": len(validation.label),
        "compile_seconds": result.compile_seconds,
        "train_seconds": result.seconds,
        **({} if test is None else {"test_overall": test.overall, "test_class_average": test.class_average}),
    }


def headline(metrics: dict[str, Any]) -> str:
    if not metrics["history"]:
        return metrics["error"]
    return f"validation accuracy {metrics['validation_overall']:.3f} (epoch {metrics['best_epoch']})"


if __name__ == "__main__":
    app.main(run, experiment="pretrain", headline=headline)
