"""Train a network on ModelNet10's training clouds, to start cables from, or to see how it does on a public set.

python -m experiments.pretrain model=adgcnn optimizer=adadelta
python -m experiments.train model=adgcnn training.init_from=runs/pretrain/quick/... training.frozen=[layers]

Each cloud is centred and divided by its own radius, which cables never are; 10 % of it is kept for validation, and the
official test split is not touched.
"""

import os
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from flax import nnx

from cablejax.io import RunLogger
from cablejax.nets import build_model
from cablejax.simulate import Split
from cablejax.train import fit
from experiments import ROOT, app
from experiments.schema import Config
from experiments.train import training_config

FILE = "classification/modelnet10_train_1024.npz"
RADIUS_MM = (
    60.0  # what a cloud's radius becomes: the networks' scale of 20 mm then spans -3 to 3, as it does for cables
)
VALIDATION_SHARE = 0.1


def modelnet(n_points: int, seed: int) -> tuple[Split, Split, list[str]]:
    """Training and validation clouds, drawn by class, and the names of the classes.

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
    held = np.concatenate([order[label[order] == c][: int(VALIDATION_SHARE * np.sum(label == c))] for c in set(label)])
    rest = np.setdiff1d(order, held)
    return _split(xyz, label, rest), _split(xyz, label, held), names


def _split(xyz: np.ndarray, label: np.ndarray, rows: np.ndarray) -> Split:
    count = len(rows)
    return Split(xyz[rows], np.ones((count, xyz.shape[1]), bool), label[rows], np.zeros(count, np.float32))  # pyright: ignore[reportArgumentType]


def run(cfg: Config, folder: Path) -> dict[str, Any]:
    """Train, choose the epoch on validation."""
    train, validation, names = modelnet(cfg.dataset.n_points, cfg.seed)
    options = {**cfg.model.options, **({"pose": "none"} if cfg.model.name in ("adgcnn", "dgcnn", "pointnet") else {})}
    model = build_model(cfg.model.name, len(names), rngs=nnx.Rngs(cfg.seed), **options)
    with RunLogger(folder / "tensorboard") as log:
        result = fit(model, train, validation, training_config(cfg), folder=folder, logger=log)
    best = result.history[result.best_epoch - 1]
    return {
        "history": [asdict(epoch) for epoch in result.history],
        "best_epoch": result.best_epoch,
        "validation_overall": best.validation_overall,
        "validation_class_average": best.validation_class_average,
        "classes": names,
        "train_clouds": len(train.label),
        "validation_clouds": len(validation.label),
        "compile_seconds": result.compile_seconds,
        "train_seconds": result.seconds,
    }


def headline(metrics: dict[str, Any]) -> str:
    return f"validation accuracy {metrics['validation_overall']:.3f} (epoch {metrics['best_epoch']})"


if __name__ == "__main__":
    app.main(run, experiment="pretrain", headline=headline)
