"""Edge convolution on a dynamic neighbour graph with channel attention, equations (10)-(14), for one small cloud."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int


class AttentionWeights(NamedTuple):
    """The two shared 1x1 convolutions of equation (12): `alpha_2` squeezes d channels to h, `alpha_1` restores them.

    Attributes:
        squeeze: Kernel of `alpha_2`, `[d, h]`.
        squeeze_bias: Its bias `[h]`.
        excite: Kernel of `alpha_1`, `[h, d]`.
        excite_bias: Its bias `[d]`.
    """

    squeeze: Float[Array, "d h"]
    squeeze_bias: Float[Array, " h"]
    excite: Float[Array, "h d"]
    excite_bias: Float[Array, " d"]


def feature_graph(features: Float[Array, "n c"], *, k: int, mask: Bool[Array, " n"] | None = None) -> Int[Array, "n k"]:
    """The k nearest points of each point in feature space, itself first, as in DGCNN's dynamic graph.

    All pairs are measured, which suits the few thousand points a network sees; for scans use `cablejax.ops.knn`. Three
    channels are measured by differences; more by a matrix product of the centred features, whose rounding (about 1e-6
    of the largest squared norm) may swap neighbours that are equally far to within it.

    Args:
        features: Coordinates or features `[n, c]`.
        k: Neighbours per point, the point itself counted. Static.
        mask: True where a row is a point `[n]`; None means all.

    Returns:
        Row numbers `[n, k]` int32 by increasing distance, ties by index; -1 where there are fewer than k valid points,
        and throughout the rows of padding.

    Raises:
        ValueError: If `k` is below 1 or above n.

    Example:
        >>> feature_graph(jnp.array([[0.0], [1.0], [3.0]]), k=2).tolist()
        [[0, 1], [1, 0], [2, 1]]
    """
    n, channels = features.shape
    if not 1 <= k <= n:
        raise ValueError(f"k: expected 1 to n = {n}, got {k}")
    mask = jnp.ones(n, dtype=bool) if mask is None else mask
    features = jax.lax.stop_gradient(jnp.where(mask[:, None], features, 0.0))
    if channels == 3:
        sq_dist = jnp.sum((features[:, None, :] - features[None, :, :]) ** 2, axis=-1)
    else:
        centred = features - jnp.sum(features, axis=0) / jnp.maximum(jnp.sum(mask), 1)
        sq_norm = jnp.sum(centred**2, axis=-1)
        product = jnp.matmul(centred, centred.T, precision=jax.lax.Precision.HIGHEST)
        sq_dist = jnp.maximum(sq_norm[:, None] - 2.0 * product + sq_norm[None, :], 0.0)
    sq_dist = jnp.where(jnp.eye(n, dtype=bool), -1.0, sq_dist)
    negative, neighbors = jax.lax.top_k(-jnp.where(mask[None, :], sq_dist, jnp.inf), k)
    found = jnp.isfinite(negative) & mask[:, None]
    return jnp.where(found, neighbors, -1)


def edge_features(features: Float[Array, "n c"], neighbors: Int[Array, "n k"]) -> Float[Array, "n k 2*c"]:
    """The edge features `(x_i, x_j - x_i)` of equation (11), literally; zero where a neighbour is missing.

    Example:
        >>> edge_features(jnp.array([[1.0], [3.0]]), jnp.array([[1], [-1]])).tolist()
        [[[1.0, 2.0]], [[0.0, 0.0]]]
    """
    center = jnp.broadcast_to(features[:, None, :], (*neighbors.shape, features.shape[1]))
    edges = jnp.concatenate([center, features[neighbors] - center], axis=-1)
    return jnp.where((neighbors >= 0)[:, :, None], edges, 0.0)


def edge_products(
    features: Float[Array, "n c"], kernel: Float[Array, "2*c d"]
) -> tuple[Float[Array, "n d"], Float[Array, "n d"]]:
    """Split the product with an edge's features into a share of the centre and one of the neighbour.

    `W [x_i, x_j - x_i] = (W1 - W2) x_i + W2 x_j`, so the matrix product is taken per point, not per edge, and an edge
    costs one addition.

    Returns:
        `(center, neighbor)`, both `[n, d]`: the product of edge (i, j) is `center[i] + neighbor[j]`.

    Raises:
        ValueError: If `kernel` does not have twice as many rows as `features` has channels.
    """
    channels = features.shape[1]
    if kernel.shape[0] != 2 * channels:
        raise ValueError(f"kernel: expected {2 * channels} rows for {channels} channels, got {kernel.shape[0]}")
    own, difference = kernel[:channels], kernel[channels:]
    return features @ (own - difference), features @ difference


def channel_attention(
    edges: Float[Array, "n k d"], valid: Bool[Array, "n k"], weights: AttentionWeights
) -> Float[Array, " d"]:
    """The weight of each channel between 0 and 1, equation (12).

    The paper does not say over what MAX and MEAN pool: here over all edges of the cloud, per channel, and the two
    1x1 convolutions have a ReLU between them, both as in CBAM.

    Args:
        edges: Edge features V `[n, k, d]`.
        valid: True where an edge exists `[n, k]`.
        weights: The shared convolutions.

    Returns:
        beta `[d]`; 0.5 up to the biases where no edge is valid.
    """
    return pooled_attention(*pool_edges(edges, valid), weights)


def pool_edges(
    edges: Float[Array, "n k d"], valid: Bool[Array, "n k"]
) -> tuple[Float[Array, " d"], Float[Array, " d"]]:
    """MAX(V) and MEAN(V) of equation (12) over the valid edges, each `[d]`; zero where there is none."""
    some = jnp.any(valid)
    largest = jnp.max(edges, axis=(0, 1), where=valid[:, :, None], initial=-jnp.inf)
    mean = jnp.sum(edges, axis=(0, 1), where=valid[:, :, None]) / jnp.maximum(jnp.sum(valid), 1)
    return jnp.where(some, largest, 0.0), mean


def pooled_attention(
    largest: Float[Array, " d"], mean: Float[Array, " d"], weights: AttentionWeights
) -> Float[Array, " d"]:
    """Equation (12) from the pooled features: `sigmoid(alpha_1(alpha_2(MAX)) + alpha_1(alpha_2(MEAN)))`, `[d]`."""

    def shared(pooled: Float[Array, " d"]) -> Float[Array, " d"]:
        return jax.nn.relu(pooled @ weights.squeeze + weights.squeeze_bias) @ weights.excite + weights.excite_bias

    return jax.nn.sigmoid(shared(largest) + shared(mean))


def edge_conv(
    features: Float[Array, "n c"],
    neighbors: Int[Array, "n k"],
    kernel: Float[Array, "2*c d"],
    *,
    scale: Float[Array, " d"],
    shift: Float[Array, " d"],
    attention: AttentionWeights | None = None,
    negative_slope: float = 0.2,
) -> Float[Array, "n d"]:
    """One AEdgeConv layer of a cloud, equations (11)-(14), the normalisation given as `scale` and `shift` per channel.

    An edge's value is `V = LeakyReLU(scale * W[x_i, x_j - x_i] + shift)`; V is weighted by channel and the largest over
    a point's neighbours is kept.

    Args:
        features: Point features `[n, c]`.
        neighbors: The graph `[n, k]`, -1 where a neighbour is missing.
        kernel: W `[2c, d]`, the first c rows for x_i.
        scale: Batch normalisation folded to a factor `[d]`.
        shift: And to an offset `[d]`.
        attention: Shared convolutions of equation (12); None leaves all channels at weight 1 (DGCNN's EdgeConv).
        negative_slope: LeakyReLU's slope below zero.

    Returns:
        New features `[n, d]`; zero for a point without neighbours.
    """
    center, neighbor = edge_products(features, kernel)
    valid = neighbors >= 0
    edges = (center[:, None, :] + neighbor[neighbors]) * scale + shift
    edges = jax.nn.leaky_relu(edges, negative_slope)
    if attention is not None:
        edges = edges * channel_attention(edges, valid, attention)
    largest = jnp.max(edges, axis=1, where=valid[:, :, None], initial=-jnp.inf)
    return jnp.where(jnp.any(valid, axis=1, keepdims=True), largest, 0.0)
