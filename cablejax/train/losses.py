"""The training losses."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Shaped

SCORE_WEIGHT = 4.0  # of the points' loss beside that of the sizes


def cross_entropy(
    logits: Float[Array, "*b classes"], labels: Int[Array, "*b"], *, label_smoothing: float = 0.0
) -> Float[Array, "*b"]:
    """Cross-entropy of each sample in nats.

    Args:
        logits: `[..., C]`.
        labels: Class numbers `[...]`.
        label_smoothing: Share of the target spread evenly over all C classes. 0 is plain cross-entropy.

    Example:
        >>> round(float(cross_entropy(jnp.zeros((1, 4)), jnp.array([2]))[0]), 4)
        1.3863
    """
    log_p = jax.nn.log_softmax(logits, axis=-1)
    own = jnp.take_along_axis(log_p, labels[..., None], axis=-1)[..., 0]
    return -(1.0 - label_smoothing) * own - label_smoothing * jnp.mean(log_p, axis=-1)


def cloud_mean(values: Shaped[Array, "b n"], mask: Bool[Array, "b n"]) -> Float[Array, " b"]:
    """Mean over each cloud's valid points `[b]`; 0 where there is none.

    Example:
        >>> cloud_mean(jnp.array([[1.0, 3.0, 99.0]]), jnp.array([[True, True, False]])).tolist()
        [2.0]
    """
    return jnp.sum(values, axis=1, where=mask) / jnp.maximum(jnp.sum(mask, axis=1), 1)


def score_loss(
    scores: Float[Array, "b n"], on_cable: Bool[Array, "b n"], mask: Bool[Array, "b n"]
) -> Float[Array, " b"]:
    """Cross-entropy of the points' scores against what they are, in nats, the mean over each cloud's valid points `[b]`.

    Training counts it `SCORE_WEIGHT` times: until the points are known, what the sizes say of them is noise.

    Args:
        scores: Logits to be the cable's `[b, n]`.
        on_cable: Whether they are `[b, n]`.
        mask: True where a row is a point `[b, n]`.

    Example:
        >>> mask = jnp.array([[True, True, False]])
        >>> round(float(score_loss(jnp.zeros((1, 3)), jnp.array([[True, False, False]]), mask)[0]), 4)
        0.6931
    """
    return cloud_mean(jax.nn.softplus(jnp.where(on_cable, -scores, scores)), mask)


def gaussian_nll(mean: Float[Array, "*b"], std: Float[Array, "*b"], target: Float[Array, "*b"]) -> Float[Array, "*b"]:
    """Negative log-likelihood of each target under its own Gaussian, without the constant `log(2 pi) / 2`.

    Args:
        mean: `[...]`.
        std: Standard deviations `[...]`, above 0, in the same unit.
        target: What was to be told `[...]`.

    Example:
        >>> float(gaussian_nll(jnp.array(1.0), jnp.array(1.0), jnp.array(3.0)))
        2.0
    """
    return jnp.log(std) + 0.5 * ((target - mean) / std) ** 2
