"""Settings of a training run."""

import dataclasses
from typing import Any

from cablejax.train.optimizers import OPTIMIZERS

MATMUL_PRECISION: dict[str, str | None] = {"float32": None, "bfloat16": "BF16_BF16_F32"}


@dataclasses.dataclass
class TrainConfig:
    """How a model is trained; everything that decides the numbers, and nothing else.

    Attributes:
        optimizer: Name in `OPTIMIZERS`.
        learning_rate: Always explicit.
        optimizer_options: The optimizer's own, see `make_optimizer`.
        epochs: Passes over the training set.
        batch_size: Clouds per gradient; the last, smaller batch of an epoch is left out (another permutation each
            epoch), so that batch statistics always see as many clouds.
        seed: Decides the order of the clouds.
        balanced: Whether all batches of an epoch hold about the same mix of classes. Batch normalisation then sees the
            same statistics from batch to batch: where the label is a length, another mix shifts the lengths themselves.
        schedule: "constant", or "cosine": the rate falls to 0 along half a cosine over the run.
        warmup_epochs: The rate rises linearly over this many epochs first.
        label_smoothing: See `cross_entropy`.
        clip_norm: See `make_optimizer`.
        ema_decay: Decay per update of the averaged weights that are evaluated and returned; None evaluates the weights
            themselves.
        patience: Stop after this many epochs without a better validation accuracy; None runs to the end.
        give_up_epoch: Stop after this many epochs where the training loss of none of them was below `give_up_loss`; None never
            gives up. For tuning: what has not begun to learn by then rarely does.
        give_up_loss: See there; nats.
        keep_best: Return the weights of the epoch with the best validation accuracy (of equals the lowest loss), not the
            last ones.
        frozen: Parts of the network whose parameters stay as they are, by dotted name ("layers", "layers.0"); their
            running statistics still follow the data.
        precision: "float32", or "bfloat16": matrix products of the forward and backward pass take their factors rounded to
            bfloat16 and add up in float32, on devices that can (a CPU goes on in float32). Weights, statistics and the
            neighbour graph stay in float32.
        steps_per_dispatch: Steps that run as one compiled call, at most.
        eval_batch_size: Clouds at a time in evaluation.
    """

    optimizer: str = "adadelta"
    learning_rate: float = 1.0
    optimizer_options: dict[str, Any] = dataclasses.field(default_factory=dict)
    epochs: int = 10
    batch_size: int = 32
    seed: int = 0
    balanced: bool = False
    schedule: str = "constant"
    warmup_epochs: float = 0.0
    label_smoothing: float = 0.0
    clip_norm: float | None = None
    ema_decay: float | None = None
    patience: int | None = None
    give_up_epoch: int | None = None
    give_up_loss: float = 0.0
    keep_best: bool = False
    frozen: tuple[str, ...] = ()
    precision: str = "float32"
    steps_per_dispatch: int = 10
    eval_batch_size: int = 32

    def validate(self) -> None:
        """Raise `ValueError` naming the first setting out of range."""
        if self.optimizer not in OPTIMIZERS:
            raise ValueError(f"optimizer: expected one of {', '.join(OPTIMIZERS)}, got {self.optimizer!r}")
        if self.schedule not in ("constant", "cosine"):
            raise ValueError(f"schedule: expected constant or cosine, got {self.schedule!r}")
        if self.precision not in MATMUL_PRECISION:
            raise ValueError(f"precision: expected one of {', '.join(MATMUL_PRECISION)}, got {self.precision!r}")
        for name in ("epochs", "batch_size", "steps_per_dispatch", "eval_batch_size"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name}: expected 1 or more, got {getattr(self, name)}")
        if not self.learning_rate > 0:
            raise ValueError(f"learning_rate: expected a number above 0, got {self.learning_rate}")
        if not 0 <= self.label_smoothing < 1:
            raise ValueError(f"label_smoothing: expected 0 or more and below 1, got {self.label_smoothing}")
        if self.ema_decay is not None and not 0 < self.ema_decay < 1:
            raise ValueError(f"ema_decay: expected a number between 0 and 1, or None, got {self.ema_decay}")
        if self.warmup_epochs < 0:
            raise ValueError(f"warmup_epochs: expected 0 or more, got {self.warmup_epochs}")
        for name in ("patience", "give_up_epoch"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise ValueError(f"{name}: expected 1 or more, or None, got {value}")
