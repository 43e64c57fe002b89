"""Edge convolution on a dynamic neighbour graph with channel attention, eqs. (10)-(14), for one small cloud."""

from collections.abc import Callable
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from cablejax.ops.cloud_by_cloud import cloud_by_cloud
from cablejax.ops.maximum import largest
from cablejax.ops.product import row_product


class AttentionWeights(NamedTuple):
    """The two shared 1x1 convolutions of eq. (12): `alpha_2` squeezes d channels to h, `alpha_1` restores them.

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


def edge_features(features: Float[Array, "n c"], neighbors: Int[Array, "n k"]) -> Float[Array, "n k 2*c"]:
    """The edge features `(x_i, x_j - x_i)` of eq. (11), literally; zero where a neighbour is missing.

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
    return row_product(features, own - difference), row_product(features, difference)


def channel_attention(
    edges: Float[Array, "n k d"], valid: Bool[Array, "n k"], weights: AttentionWeights
) -> Float[Array, " d"]:
    """The weight of each channel between 0 and 1, eq. (12), literally.

    The paper does not say over what MAX and MEAN pool, nor what stands between the convolutions: here they pool over all
    edges of the cloud, per channel, and a ReLU stands between, both as in CBAM (Woo et al. 2018).

    Args:
        edges: Edge features V `[n, k, d]`, of which at least one is valid.
        valid: True where an edge exists `[n, k]`.
        weights: The shared convolutions.

    Returns:
        beta `[d]`.
    """
    overall = largest(jnp.where(valid[:, :, None], edges, -jnp.inf).reshape(-1, edges.shape[2]), 0)
    mean = jnp.sum(edges, axis=(0, 1), where=valid[:, :, None]) / jnp.sum(valid)
    return pooled_attention(overall, mean, weights)


def pooled_attention(
    largest: Float[Array, " d"], mean: Float[Array, " d"], weights: AttentionWeights
) -> Float[Array, " d"]:
    """Eq. (12) from the pooled features: `sigmoid(alpha_1(alpha_2(MAX)) + alpha_1(alpha_2(MEAN)))`, `[d]`."""

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
    """One AEdgeConv layer of a cloud, eqs. (11)-(14), the normalisation given as `scale` and `shift` per channel.

    An edge's feature is `V = scale * W[x_i, x_j - x_i] + shift`; V is weighted by channel, the largest over a point's
    neighbours is kept, and LeakyReLU follows. No tensor per edge is made: see `aggregate_edges`.

    Args:
        features: Point features `[n, c]`.
        neighbors: The graph `[n, k]`, -1 where a neighbour is missing.
        kernel: W `[2c, d]`, the first c rows for x_i.
        scale: Batch normalisation folded to a factor `[d]`.
        shift: And to an offset `[d]`.
        attention: Shared convolutions of eq. (12); None leaves all channels at weight 1 (DGCNN's EdgeConv).
        negative_slope: LeakyReLU's slope below zero.

    Returns:
        New features `[n, d]`; zero for a point without neighbours.
    """
    center, neighbor = edge_products(features, kernel)
    return aggregate_edges(
        center, neighbor, neighbors, scale=scale, shift=shift, attention=attention, negative_slope=negative_slope
    )


def aggregate_edges(
    center: Float[Array, "n d"],
    neighbor: Float[Array, "n d"],
    neighbors: Int[Array, "n k"],
    *,
    scale: Float[Array, " d"],
    shift: Float[Array, " d"],
    attention: AttentionWeights | None = None,
    negative_slope: float = 0.2,
) -> Float[Array, "n d"]:
    """Eqs. (12)-(14) from the shares of `edge_products`.

    V is affine in the neighbour's share, so its largest over a point's edges is found at the neighbour's largest share
    (smallest, where `scale` is negative), and its mean over the cloud from each point's number of incoming edges. The
    channel weights are positive and shared by all edges, so they may follow the maximum.
    """
    largest = _largest_edges(center, neighbor, neighbors, scale, shift)
    if attention is not None:
        largest = largest * _attention_of(largest, center, neighbor, neighbors, scale, shift, attention)[None, :]
    return jax.nn.leaky_relu(largest, negative_slope)


def edge_attention(
    center: Float[Array, "n d"],
    neighbor: Float[Array, "n d"],
    neighbors: Int[Array, "n k"],
    *,
    scale: Float[Array, " d"],
    shift: Float[Array, " d"],
    attention: AttentionWeights,
) -> Float[Array, " d"]:
    """The channel weights `[d]` of eq. (12) that `aggregate_edges` applies, to look at."""
    largest = _largest_edges(center, neighbor, neighbors, scale, shift)
    return _attention_of(largest, center, neighbor, neighbors, scale, shift, attention)


def _largest_edges(center: Array, neighbor: Array, neighbors: Array, scale: Array, shift: Array) -> Float[Array, "n d"]:
    """The largest V of each point's edges; zero for a point without neighbours."""
    exists = neighbors[:, :1] >= 0
    sign = jnp.where(scale < 0, -1.0, 1.0)[None, :]
    extreme = sign * neighbor_max(sign * neighbor, neighbors)
    value = scale[None, :] * (center + jnp.where(exists, extreme, 0.0)) + shift[None, :]
    return jnp.where(exists, value, 0.0)


def _attention_of(
    of_points: Array,
    center: Array,
    neighbor: Array,
    neighbors: Array,
    scale: Array,
    shift: Array,
    attention: AttentionWeights,
) -> Float[Array, " d"]:
    """Eq. (12) from the points' largest V and the mean V over all edges."""
    exists = neighbors[:, :1] >= 0
    edges = jnp.sum(neighbors >= 0, axis=1).astype(center.dtype)
    mean = (edges @ center + in_degree(neighbors) @ neighbor) / jnp.maximum(jnp.sum(edges), 1.0)
    overall = largest(jnp.where(exists, of_points, -jnp.inf), 0)
    overall = jnp.where(jnp.any(exists), overall, 0.0)
    return pooled_attention(overall, scale * mean + shift, attention)


def edge_statistics(
    center: Float[Array, "b n d"], neighbor: Float[Array, "b n d"], neighbors: Int[Array, "b n k"]
) -> tuple[Float[Array, " d"], Float[Array, " d"]]:
    """Mean and variance per channel of `center_i + neighbor_j` over all edges of a batch, for batch normalisation.

    The variance is that of the centres, weighted by their edges, that of the neighbours, weighted by theirs, and twice
    the covariance, which needs the sum of each point's neighbours and no tensor per edge. Each is taken about its mean.

    Returns:
        `(mean [d], variance [d])`, the variance with divisor the number of edges.
    """
    out_edges = jnp.sum(neighbors >= 0, axis=2).astype(center.dtype)[..., None]
    in_edges = jax.vmap(in_degree)(neighbors)[..., None]
    total = jnp.maximum(jnp.sum(out_edges), 1.0)
    center_mean = jnp.sum(out_edges * center, axis=(0, 1)) / total
    neighbor_mean = jnp.sum(in_edges * neighbor, axis=(0, 1)) / total
    center = center - center_mean[None, None, :]
    neighbor = neighbor - neighbor_mean[None, None, :]
    sums = jax.vmap(neighbor_sum)(neighbor, neighbors)
    squares = jnp.sum(out_edges * center**2 + in_edges * neighbor**2 + 2.0 * center * sums, axis=(0, 1))
    return center_mean + neighbor_mean, squares / total


def in_degree(neighbors: Int[Array, "n k"]) -> Float[Array, " n"]:
    """How many edges end at each point.

    Example:
        >>> in_degree(jnp.array([[1, 2], [1, -1], [2, 1]])).tolist()
        [0.0, 3.0, 2.0]
    """
    n = neighbors.shape[0]
    return jnp.zeros(n + 1, jnp.float32).at[_padded(neighbors)].add(1.0, mode="promise_in_bounds")[:n]


@jax.custom_vjp
def neighbor_max(values: Float[Array, "n d"], neighbors: Int[Array, "n k"]) -> Float[Array, "n d"]:
    """The largest value among each point's neighbours, per channel; -inf where there is none.

    The gradient goes to the first neighbour that holds it. Nothing per edge is kept: the backward pass finds the
    neighbour again, by comparing the values with one another and not with the kept maximum, since a value that XLA computes
    anew in another fusion may differ in its last bit from what was kept.
    """
    return _slot_max(values, neighbors)


def _neighbor_max_forward(values: Array, neighbors: Array) -> tuple[Array, tuple[Array, Array]]:
    return neighbor_max(values, neighbors), (values, neighbors)


def _neighbor_max_backward(residuals: tuple[Array, Array], grad: Array) -> tuple[Array, None]:
    return _to_holders(grad, *residuals), None


neighbor_max.defvjp(_neighbor_max_forward, _neighbor_max_backward)


@jax.custom_vjp
def neighbor_sum(values: Float[Array, "n d"], neighbors: Int[Array, "n k"]) -> Float[Array, "n d"]:
    """The sum over each point's neighbours, per channel; the gradient is the sum over incoming edges."""
    return _slot_sum(values, neighbors)


def _neighbor_sum_forward(values: Array, neighbors: Array) -> tuple[Array, Array]:
    return neighbor_sum(values, neighbors), neighbors


def _neighbor_sum_backward(neighbors: Array, grad: Array) -> tuple[Array, None]:
    return _to_neighbors(grad, neighbors), None


neighbor_sum.defvjp(_neighbor_sum_forward, _neighbor_sum_backward)


def _over_slots(
    combine: Callable[[Array, Array], Array], fill: float, values: Float[Array, "n d"], neighbors: Int[Array, "n k"]
) -> Float[Array, "n d"]:
    """Combine the neighbours' rows slot by slot: unrolled, XLA makes one pass of it, without a tensor per edge."""
    slots, rows = _padded(neighbors), _with_row(values, fill)
    total = rows.at[slots[:, 0]].get(mode="promise_in_bounds")
    for slot in range(1, neighbors.shape[1]):
        total = combine(total, rows.at[slots[:, slot]].get(mode="promise_in_bounds"))
    return total


def _first_holder(values: Float[Array, "n d"], neighbors: Int[Array, "n k"]) -> Int[Array, "n d"]:
    """The row of the first neighbour whose value is the largest, per channel; n where there is none."""
    slots, rows = _padded(neighbors), _with_row(values, -jnp.inf)
    largest = jnp.full(values.shape, -jnp.inf, values.dtype)
    source = jnp.full(values.shape, values.shape[0], jnp.int32)
    for slot in range(neighbors.shape[1]):
        value = rows.at[slots[:, slot]].get(mode="promise_in_bounds")
        larger = value > largest  # an equal one comes too late
        largest, source = jnp.where(larger, value, largest), jnp.where(larger, slots[:, slot, None], source)
    return source


def _scatter_to_holders(
    grad: Float[Array, "n d"], values: Float[Array, "n d"], neighbors: Int[Array, "n k"]
) -> Float[Array, "n d"]:
    """Add each point's gradient, channel by channel, to the row that holds its largest value."""
    n, d = values.shape
    source = _first_holder(values, neighbors)
    # One coordinate an entry: XLA builds a list of coordinates for every dimension that is indexed.
    flat = source * d + jnp.arange(d)[None, :]
    total = jnp.zeros((n + 1) * d, grad.dtype).at[flat.reshape(-1)].add(grad.reshape(-1), mode="promise_in_bounds")
    return total.reshape(n + 1, d)[:n]


def _scatter_to_neighbors(grad: Float[Array, "n d"], neighbors: Int[Array, "n k"]) -> Float[Array, "n d"]:
    """Add each point's gradient to the rows of its neighbours."""
    n, k = neighbors.shape
    total = jnp.zeros((n + 1, grad.shape[1]), grad.dtype)
    rows = jnp.repeat(grad, k, axis=0)
    return total.at[_padded(neighbors).reshape(-1)].add(rows, mode="promise_in_bounds")[:n]


_slot_max = cloud_by_cloud(partial(_over_slots, jnp.maximum, -jnp.inf))
_slot_sum = cloud_by_cloud(partial(_over_slots, jnp.add, 0.0))
# A scatter is one thread's work: into a table that stays in the cache it is ten times faster than into a batch of them.
_to_holders = cloud_by_cloud(_scatter_to_holders)
_to_neighbors = cloud_by_cloud(_scatter_to_neighbors)


def _padded(neighbors: Int[Array, "n k"]) -> Int[Array, "n k"]:
    """The graph with n, the row behind the last, in place of -1."""
    return jnp.where(neighbors < 0, neighbors.shape[0], neighbors)


def _with_row(values: Float[Array, "n d"], fill: float) -> Float[Array, "m d"]:
    """The rows and one more for missing neighbours."""
    return jnp.concatenate([values, jnp.full((1, values.shape[1]), fill, values.dtype)])
