"""A network that labels each point of a cloud by the part it lies on, out of ADGCNN's edge convolutions."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Bool, Float

from cablejax.nets.aedgeconv import AEdgeConv
from cablejax.nets.head import PooledLayer
from cablejax.nets.init import he_normal, lecun_normal
from cablejax.nets.norm import BatchNorm
from cablejax.ops.cylinder import principal_frame
from cablejax.ops.eigen import symmetric_eigen
from cablejax.ops.feature_graph import feature_graph
from cablejax.ops.moments import local_moments

LOCAL_K = (8, 32)  # neighbourhoods whose shape the network is told
LOCAL_CHANNELS = 4 * len(LOCAL_K)
LOCAL_MM = 5.0  # length that becomes 1 in them: a few spacings of the points


def local_shape(xyz: Float[Array, "n 3"], mask: Bool[Array, " n"]) -> Float[Array, "n c"]:
    """How long, wide and thick the neighbourhood of each point is, and how far its mean lies off, for every `LOCAL_K`.

    The first three are the square roots of the eigenvalues of its covariance. They do not depend on the cloud's rotation;
    a round surface of radius R is R^-1 times its width squared thick, a flat one has no thickness but the noise.
    """
    graph = feature_graph(xyz, k=min(max(LOCAL_K), xyz.shape[0]), mask=mask)
    found = []
    for k in LOCAL_K:
        moments = local_moments(xyz, graph[:, :k])
        spread = jnp.sqrt(jnp.maximum(symmetric_eigen(moments.covariance).values, 0.0))
        found += [spread, jnp.linalg.norm(moments.mean - xyz, axis=1, keepdims=True)]
    return jnp.where(mask[:, None], jnp.concatenate(found, axis=1) / LOCAL_MM, 0.0)


class PartNetwork(nnx.Module):
    """Label the points of clouds: edge convolutions with channel attention, the cloud's pooled feature given to each point.

    The way of DGCNN's segmentation network with the layers of ADGCNN. The raster of ADGCNN is left out: it unrolls one
    cable, and here there are walls, trays and several cables.

    Args:
        num_classes: Parts P.
        k: Neighbours per point in every graph, the point itself counted.
        attention: Channel attention, eq. (12).
        widths: Channels of the edge convolutions.
        shared_width: Channels of the shared layer before pooling.
        head: Channels of the layers that label.
        scale_mm: Length that becomes 1 at the input.
    """

    def __init__(
        self,
        num_classes: int,
        *,
        k: int = 16,
        attention: bool = True,
        widths: Sequence[int] = (32, 64, 64),
        shared_width: int = 256,
        head: Sequence[int] = (128, 64),
        scale_mm: float = 40.0,
        rngs: nnx.Rngs,
    ):
        if num_classes < 2:
            raise ValueError(f"num_classes: expected 2 or more, got {num_classes}")
        self.scale_mm = scale_mm
        inputs = [3 + LOCAL_CHANNELS, *widths[:-1]]
        self.layers = nnx.List(
            [AEdgeConv(c, d, k=k, attention=attention, rngs=rngs) for c, d in zip(inputs, widths, strict=True)]
        )
        joined = inputs[0] + sum(widths)
        self.shared = PooledLayer(joined, shared_width, rngs=rngs)
        # The cloud's feature is the same for all its points: its share of the first layer is computed once.
        self.whole = nnx.Linear(2 * shared_width, head[0], use_bias=False, kernel_init=he_normal, rngs=rngs)
        sizes = [joined, *head]
        self.hidden = nnx.List(
            [
                nnx.Linear(c, d, use_bias=False, kernel_init=he_normal, rngs=rngs)
                for c, d in zip(sizes[:-1], head, strict=True)
            ]
        )
        self.norms = nnx.List([BatchNorm(d) for d in head])
        self.logits = nnx.Linear(head[-1], num_classes, kernel_init=lecun_normal, rngs=rngs)

    def __call__(self, xyz: Float[Array, "b n 3"], mask: Bool[Array, "b n"]) -> Float[Array, "b n parts"]:
        """Logits `[b, n, P]` of clouds in mm; rows where `mask` is False change nothing."""
        return self.label(jax.lax.stop_gradient(jax.vmap(self._inputs)(xyz, mask)), mask)[0]

    def label(
        self, features: Float[Array, "b n c"], mask: Bool[Array, "b n"]
    ) -> tuple[Float[Array, "b n parts"], Float[Array, "b pooled"]]:
        """Logits `[b, n, P]` of clouds given by their points' features, and the feature of each whole cloud."""
        maps, x = [features], features
        for layer in self.layers:
            x = layer(x, mask)
            maps.append(x)
        joined = jnp.concatenate(maps, axis=-1)
        weight = mask.astype(joined.dtype)
        pooled = self.shared(joined, mask)
        added = self.whole(pooled)[:, None, :]
        x = joined
        for linear, norm in zip(self.hidden, self.norms, strict=True):
            x = jax.nn.leaky_relu(norm(linear(x) + added, weight), 0.2)
            added = 0.0
        return self.logits(x), pooled

    def _inputs(self, xyz: Array, mask: Array) -> Float[Array, "n c"]:
        """Coordinates along the cloud's principal axes in scales, and the local shape."""
        centroid, rotation = principal_frame(xyz, mask)
        posed = jnp.where(mask[:, None], xyz - centroid[None, :], 0.0) @ rotation.T
        return jnp.concatenate([posed / self.scale_mm, local_shape(xyz, mask)], axis=1)
