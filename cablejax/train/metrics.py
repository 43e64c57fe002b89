"""Overall and class-average accuracy, eqs. (20) and (21), and a model's evaluation on a split."""

from functools import partial
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jaxtyping import Array

from cablejax.geometry.robust import COVERAGE
from cablejax.train.losses import cross_entropy


@runtime_checkable
class Clouds(Protocol):
    """Labelled clouds of one padded size, such as `cablejax.simulate.Split`.

    Attributes:
        xyz: `[N, n, 3]`, mm, centred.
        mask: True where a row is a point `[N, n]`.
        label: Class numbers `[N]`, or of labelled points `[N, n]`.
    """

    @property
    def xyz(self) -> Array | np.ndarray: ...
    @property
    def mask(self) -> Array | np.ndarray: ...
    @property
    def label(self) -> Array | np.ndarray: ...


class DiameterMetrics(NamedTuple):
    """How well a regression head tells the diameter.

    Attributes:
        rmse_mm: Root mean square error.
        coverage: Share of clouds whose true diameter lies within 1.96 of the standard deviations that the head gives; .95
            where these are right.
    """

    rmse_mm: float
    coverage: float


class Metrics(NamedTuple):
    """What an evaluation found.

    Attributes:
        overall: Share of clouds classified rightly, eq. (20), in 0..1.
        class_average: Mean over the classes present of that share within the class, eq. (21).
        loss: Mean cross-entropy, nats.
        confusion: Counts `[C, C]`, rows the true class, columns the predicted one.
        diameter: Of a network with a regression head, else None.
    """

    overall: float
    class_average: float
    loss: float
    confusion: np.ndarray
    diameter: DiameterMetrics | None = None


def confusion_matrix(labels: np.ndarray, predicted: np.ndarray, num_classes: int) -> np.ndarray:
    """Counts `[C, C]`, rows the true class, columns the predicted one.

    Example:
        >>> confusion_matrix(np.array([0, 0, 1]), np.array([0, 1, 1]), 2).tolist()
        [[1, 1], [0, 1]]
    """
    flat = np.bincount(np.asarray(labels) * num_classes + np.asarray(predicted), minlength=num_classes**2)
    return flat.reshape(num_classes, num_classes)


def overall_accuracy(confusion: np.ndarray) -> float:
    """Eq. (20) as a share of 1: right answers over all; NaN without samples."""
    total = confusion.sum()
    return float(np.trace(confusion) / total) if total else float("nan")


def class_average_accuracy(confusion: np.ndarray) -> float:
    """Eq. (21) as a share of 1: the mean over classes of the share that is right; classes without samples left out.

    Example:
        >>> class_average_accuracy(np.array([[8, 0], [1, 1]]))
        0.75
    """
    samples = confusion.sum(axis=1)
    present = samples > 0
    return float(np.mean(np.diag(confusion)[present] / samples[present])) if present.any() else float("nan")


def intersection_over_union(confusion: np.ndarray) -> np.ndarray:
    """Of each class `[C]`: what is rightly given to it over what is it or is given to it; NaN where there is neither.

    Example:
        >>> intersection_over_union(np.array([[8, 0], [1, 1]])).round(3).tolist()
        [0.889, 0.5]
    """
    both = np.diag(confusion).astype(float)
    either = confusion.sum(axis=0) + confusion.sum(axis=1) - both
    return np.divide(both, either, out=np.full(len(both), np.nan), where=either > 0)


def evaluate(model: nnx.Module, split: Clouds, *, batch_size: int = 32) -> Metrics:
    """Classify a split in evaluation mode (running statistics, no dropout); the model itself is not changed.

    Args:
        model: Called as `(xyz, mask) -> logits`.
        split: Labelled clouds.
        batch_size: Clouds at a time.

    Raises:
        ValueError: If the split is empty or a label is not a class of the model.
    """
    graphdef, state = nnx.split(eval_copy(model))
    return score_all(predict(graphdef, state, split, batch_size=batch_size), split)


def eval_copy(model: nnx.Module) -> nnx.Module:
    """The same model in evaluation mode; it shares the arrays but not the mode."""
    other = nnx.merge(*nnx.split(model))
    other.eval()
    return other


def also_learnt(model: nnx.Module) -> str | None:
    """Field of a split that a network learns beside the classes.

    "diameter_mm" where it has a regression head (`with_diameter`), "on_cable" where it scores the points (`estimate`).
    """
    if hasattr(model, "estimate"):
        return "on_cable"
    return "diameter_mm" if getattr(model, "diameter", None) is not None else None


def field_of(split: Clouds, name: str) -> np.ndarray:
    """A field of a split that not every network learns.

    Raises:
        ValueError: If the split does not know it.
    """
    if getattr(split, name, None) is None:
        raise ValueError(f"split: expected clouds with {name}, which this network learns; got none")
    return np.asarray(getattr(split, name))


def arrays_of(split: Clouds, *, also: str | None) -> list[np.ndarray]:
    """What training takes of a split: points, masks, classes, and what `also_learnt` names."""
    arrays = [np.asarray(each) for each in (split.xyz, split.mask, split.label)]
    return arrays if also is None else [*arrays, field_of(split, also)]


def predict(graphdef: Any, state: Any, split: Clouds, *, batch_size: int) -> tuple[np.ndarray, ...]:
    """Logits of a split, `[N, C]` or by point `[N, n, C]`; of a network that tells diameters also `SizeEstimate`'s rest.

    The model is one split by `nnx.split`.
    """
    total = len(split.xyz)
    if total == 0:
        raise ValueError("split: expected at least one cloud, got none")
    batch_size = min(batch_size, total)
    batches = -(-total // batch_size)
    rows = np.minimum(np.arange(batches * batch_size), total - 1).reshape(batches, batch_size)
    xyz, mask = np.asarray(split.xyz), np.asarray(split.mask)
    # Batch by batch: inside a loop XLA is slow at convolutions on the CPU (`make_plan`). Gathered outside, so that splits of
    # any number of clouds share one program.
    found = [jax.device_get(_outputs(graphdef, state, xyz[row], mask[row])) for row in rows]
    return tuple(np.concatenate(each)[:total] for each in zip(*found, strict=True))


def score_all(outputs: tuple[np.ndarray, ...], split: Clouds) -> Metrics:
    """Metrics of `predict`'s outputs against a split; of labelled points over all the valid ones."""
    label = np.asarray(split.label)
    valid = ... if label.ndim == 1 else np.asarray(split.mask)
    metrics = score(outputs[0][valid], label[valid])
    return (
        metrics
        if len(outputs) == 1
        else metrics._replace(diameter=diameter_score(outputs[1], outputs[2], field_of(split, "diameter_mm")))
    )


def diameter_score(mean: np.ndarray, std: np.ndarray, truth: np.ndarray) -> DiameterMetrics:
    """Error and coverage of diameters `[N]`.

    Example:
        >>> diameter_score(np.array([30.0, 40.0]), np.array([0.1, 0.1]), np.array([30.1, 40.7]))
        DiameterMetrics(rmse_mm=0.5, coverage=0.5)
    """
    error = np.asarray(mean, np.float64) - truth
    return DiameterMetrics(round(float(np.sqrt(np.mean(error**2))), 9), float(np.mean(np.abs(error) <= COVERAGE * std)))


def score(logits: np.ndarray, labels: np.ndarray) -> Metrics:
    """Metrics of logits `[N, C]` against labels `[N]`.

    Raises:
        ValueError: If a label is not in 0..C-1.
    """
    classes = logits.shape[1]
    if labels.min() < 0 or labels.max() >= classes:
        raise ValueError(f"label: expected 0 to {classes - 1}, got {labels.min()} to {labels.max()}")
    confusion = confusion_matrix(labels, logits.argmax(axis=1), classes)
    loss = float(np.mean(np.asarray(cross_entropy(jnp.asarray(logits), jnp.asarray(labels)))))
    return Metrics(overall_accuracy(confusion), class_average_accuracy(confusion), loss, confusion)


@partial(jax.jit, static_argnums=0)
def _outputs(graphdef: Any, state: Any, xyz: Array, mask: Array) -> tuple[Array, ...]:
    """Logits `[b, C]` of the clouds of a batch; of a network that tells diameters these and their deviations too."""
    model = nnx.merge(graphdef, state, copy=True)
    also = also_learnt(model)
    if also is None:
        return (model(xyz, mask),)
    return tuple((model.estimate if also == "on_cable" else model.with_diameter)(xyz, mask))[:3]
