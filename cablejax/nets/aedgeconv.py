"""The AEdgeConv layer: edge convolution with channel attention, eqs. (11)-(14), batch normalisation included."""

from functools import partial

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Bool, Float

from cablejax.nets.init import he_normal, lecun_normal
from cablejax.nets.norm import BatchNorm
from cablejax.ops.edges import AttentionWeights, aggregate_edges, edge_attention, edge_products, edge_statistics
from cablejax.ops.feature_graph import feature_graph


class ChannelAttention(nnx.Module):
    """The two shared 1x1 convolutions of eq. (12).

    Args:
        features: Channels d.
        reduction: d is squeezed to `d // reduction` channels, at least 4.
    """

    def __init__(self, features: int, *, reduction: int = 4, rngs: nnx.Rngs):
        hidden = max(features // reduction, 4)
        self.squeeze = nnx.Linear(features, hidden, kernel_init=lecun_normal, rngs=rngs)
        self.excite = nnx.Linear(hidden, features, kernel_init=lecun_normal, rngs=rngs)

    def weights(self) -> AttentionWeights:
        """The parameters as `cablejax.ops` takes them."""
        assert self.squeeze.bias is not None
        assert self.excite.bias is not None
        return AttentionWeights(
            self.squeeze.kernel[...], self.squeeze.bias[...], self.excite.kernel[...], self.excite.bias[...]
        )


class AEdgeConv(nnx.Module):
    """Edge convolution on a graph that is rebuilt from the layer's own input.

    Args:
        in_features: Channels c of the points.
        features: Channels d of the edges and of the result.
        k: Neighbours per point, the point itself counted.
        attention: Channel attention, eq. (12); without it the layer is DGCNN's EdgeConv.
        negative_slope: LeakyReLU's slope below zero.
    """

    def __init__(
        self,
        in_features: int,
        features: int,
        *,
        k: int,
        attention: bool = True,
        negative_slope: float = 0.2,
        rngs: nnx.Rngs,
    ):
        self.k = k
        self.negative_slope = negative_slope
        self.kernel = nnx.Param(he_normal(rngs.params(), (2 * in_features, features), jnp.float32))
        self.norm = BatchNorm(features)
        self.attention = ChannelAttention(features, rngs=rngs) if attention else None

    def __call__(self, x: Float[Array, "b n c"], mask: Bool[Array, "b n"]) -> Float[Array, "b n d"]:
        """New point features `[b, n, d]`, zero on padding."""
        graph, center, neighbor, folded = self._edges(x, mask)
        weights = None if self.attention is None else self.attention.weights()
        aggregate = partial(aggregate_edges, **folded, attention=weights, negative_slope=self.negative_slope)
        return jax.vmap(aggregate)(center, neighbor, graph)

    def channel_weights(self, x: Float[Array, "b n c"], mask: Bool[Array, "b n"]) -> Float[Array, "b d"]:
        """The weights between 0 and 1 that channel attention gives each cloud's channels, eq. (12); 1 without it."""
        graph, center, neighbor, folded = self._edges(x, mask)
        if self.attention is None:
            return jnp.ones((x.shape[0], center.shape[-1]), x.dtype)
        weigh = partial(edge_attention, **folded, attention=self.attention.weights())
        return jax.vmap(weigh)(center, neighbor, graph)

    def _edges(self, x: Array, mask: Array) -> tuple[Array, Array, Array, dict[str, Array]]:
        """Graph, the shares of centres and neighbours, and the batch normalisation as scale and shift."""
        graph = jax.vmap(lambda rows, valid: feature_graph(rows, k=self.k, mask=valid))(x, mask)
        center, neighbor = jax.vmap(edge_products, in_axes=(0, None))(x, self.kernel[...])
        if self.norm.use_running_average:
            mean, var = self.norm.mean[...], self.norm.var[...]
        else:
            mean, var = edge_statistics(center, neighbor, graph)
            self.norm.update(mean, var)
        scale, shift = self.norm.fold(mean, var)
        return graph, center, neighbor, {"scale": scale, "shift": shift}
