"""Train one network under one optimizer: Figures 5-13 are sweeps of this.

python -m experiments.train model=adgcnn optimizer=adadelta
python -m experiments.train -m experiment=fig13_optimizers
"""

from dataclasses import asdict
from pathlib import Path
from typing import Any

from cablejax.io import RunLogger
from cablejax.simulate import Split
from cablejax.train import Metrics, TrainingDiverged, TrainResult, evaluate
from experiments.harness import app
from experiments.harness.schema import Config
from experiments.material.training import clouds_of, diverged, fit_on_test, fitted, held_out


def run(cfg: Config, folder: Path) -> dict[str, Any]:
    """Train in a folder: checkpoints to go on from, curves for TensorBoard."""
    with RunLogger(folder / "tensorboard") as log:
        return measured(cfg, folder, log)


def measured(cfg: Config, folder: Path | None = None, log: RunLogger | None = None) -> dict[str, Any]:
    """Train, choose the epoch on validation, and touch the test split once, or not at all while tuning.

    Args:
        cfg: The whole configuration.
        folder: Where a killed run is gone on with; None keeps nothing.
        log: Where curves go; None draws none.
    """
    labels = [f"{size:g}" for size in cfg.dataset.sizes_mm2]
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
        if log is not None:
            _log_outcome(log, cfg, test, split, labels)
        metrics |= {
            "test_overall": test.overall,
            "test_class_average": test.class_average,
            "test_loss": test.loss,
            "test_confusion": test.confusion.tolist(),
            **fit_on_test(clouds_of(cfg.dataset, cfg.dataset.test_per_class), cfg.dataset.filtered),
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
