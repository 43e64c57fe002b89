"""What a training run leaves behind: one record an epoch."""

import dataclasses
from collections.abc import Sequence

from cablejax.train.metrics import Metrics


@dataclasses.dataclass(frozen=True)
class EpochRecord:
    """What one epoch did. Accuracies are shares of 1; validation is None where there is none.

    Attributes:
        epoch: Counted from 1.
        train_loss: Mean over the epoch's batches, in training mode, each before its update.
        train_overall: Share of the epoch's clouds classified rightly, in training mode.
        validation_loss: Mean cross-entropy after the epoch, nats.
        validation_overall: Eq. (20).
        validation_class_average: Eq. (21).
        learning_rate: Of the last update.
        grad_norm: Mean global norm of the batches' gradients.
        seconds: Training time of the epoch; compilation and validation not counted.
        validation_rmse_mm: Of a regression head, see `DiameterMetrics`; None without.
        validation_coverage: Likewise.
        losses: Of every batch of the epoch, in order, each before its update; a list, as JSON gives it back.
    """

    epoch: int
    train_loss: float
    train_overall: float
    validation_loss: float | None
    validation_overall: float | None
    validation_class_average: float | None
    learning_rate: float
    grad_norm: float
    seconds: float
    validation_rmse_mm: float | None = None
    validation_coverage: float | None = None
    losses: list[float] = dataclasses.field(default_factory=list)

    def with_validation(self, metrics: Metrics) -> "EpochRecord":
        """The record with an evaluation's figures."""
        return dataclasses.replace(
            self,
            validation_loss=metrics.loss,
            validation_overall=metrics.overall,
            validation_class_average=metrics.class_average,
            validation_rmse_mm=None if metrics.diameter is None else metrics.diameter.rmse_mm,
            validation_coverage=None if metrics.diameter is None else metrics.diameter.coverage,
        )

    def scalars(self) -> dict[str, float]:
        """The figures under the names of their TensorBoard curves."""
        named = {
            "train/loss": self.train_loss,
            "train/overall": self.train_overall,
            "train/learning_rate": self.learning_rate,
            "train/grad_norm": self.grad_norm,
            "train/seconds": self.seconds,
            "validation/loss": self.validation_loss,
            "validation/overall": self.validation_overall,
            "validation/class_average": self.validation_class_average,
            "validation/rmse_mm": self.validation_rmse_mm,
            "validation/coverage": self.validation_coverage,
        }
        return {name: value for name, value in named.items() if value is not None}


def best_epoch(history: Sequence[EpochRecord]) -> int:
    """The epoch with the best validation accuracy, of equals the lowest loss; the last one without validation.

    Raises:
        ValueError: If the history is empty.
    """
    if not history:
        raise ValueError("history: expected at least one epoch, got none")
    if history[-1].validation_overall is None:
        return history[-1].epoch
    ranked = max(history, key=lambda each: (each.validation_overall or 0.0, -(each.validation_loss or 0.0)))
    return ranked.epoch


def out_of_patience(history: Sequence[EpochRecord], patience: int | None) -> bool:
    """Whether `patience` epochs have passed since the best one."""
    return patience is not None and bool(history) and len(history) - best_epoch(history) >= patience


def given_up(history: Sequence[EpochRecord], epoch: int | None, loss: float) -> bool:
    """Whether so many epochs have passed, and in none of them the training loss was below `loss`."""
    return epoch is not None and len(history) >= epoch and min(each.train_loss for each in history) >= loss
