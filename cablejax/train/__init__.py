"""Training: optimizers by name, one loop that can be killed at any moment, and the paper's two accuracies."""

from cablejax.train.batched_fits import fit_together
from cablejax.train.classify import classify_cable
from cablejax.train.config import TrainConfig
from cablejax.train.engine import TrainingDiverged
from cablejax.train.fitting import TrainResult, fit
from cablejax.train.history import EpochRecord, best_epoch
from cablejax.train.losses import cross_entropy
from cablejax.train.metrics import (
    Clouds,
    DiameterMetrics,
    Metrics,
    class_average_accuracy,
    confusion_matrix,
    evaluate,
    intersection_over_union,
    overall_accuracy,
)
from cablejax.train.optimizers import OPTIMIZERS, make_optimizer
from cablejax.train.transfer import Transferred, initialise_from

__all__ = [
    "OPTIMIZERS",
    "Clouds",
    "DiameterMetrics",
    "EpochRecord",
    "Metrics",
    "TrainConfig",
    "TrainResult",
    "TrainingDiverged",
    "Transferred",
    "best_epoch",
    "class_average_accuracy",
    "classify_cable",
    "confusion_matrix",
    "cross_entropy",
    "evaluate",
    "fit",
    "fit_together",
    "initialise_from",
    "intersection_over_union",
    "make_optimizer",
    "overall_accuracy",
]
