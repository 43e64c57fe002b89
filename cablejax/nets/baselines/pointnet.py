"""PointNet (Qi et al. 2017), the classification network, on the cloud's points."""

from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Bool, Float

from cablejax.nets.head import Classifier, pool_points
from cablejax.nets.init import he_normal
from cablejax.nets.input_channels import pose_channels, pose_clouds
from cablejax.nets.norm import BatchNorm


class PointLayers(nnx.Module):
    """Layers shared by all points, each with batch normalisation and ReLU, eq. (10).

    Args:
        in_features: Channels of the input.
        widths: Channels of the layers.
    """

    def __init__(self, in_features: int, widths: Sequence[int], *, rngs: nnx.Rngs):
        sizes = [in_features, *widths]
        self.linears = nnx.List(
            [nnx.Linear(c, d, kernel_init=he_normal, rngs=rngs) for c, d in zip(sizes[:-1], widths, strict=True)]
        )
        self.norms = nnx.List([BatchNorm(d) for d in widths])

    def __call__(self, x: Float[Array, "b n c"], mask: Bool[Array, "b n"]) -> Float[Array, "b n d"]:
        weight = mask.astype(jnp.float32)
        for linear, norm in zip(self.linears, self.norms, strict=True):
            x = jax.nn.relu(norm(linear(x), weight))
        return x


class Alignment(nnx.Module):
    """A T-net: predicts a `[c, c]` matrix from all points, the identity at the start.

    Args:
        features: Channels c.
    """

    def __init__(self, features: int, *, rngs: nnx.Rngs):
        self.features = features
        self.points = PointLayers(features, (64, 128, 1024), rngs=rngs)
        self.head = Classifier(1024, (512, 256), features * features, negative_slope=0.0, rngs=rngs)
        self.head.logits.kernel[...] = jnp.zeros_like(self.head.logits.kernel[...])

    def __call__(self, x: Float[Array, "b n c"], mask: Bool[Array, "b n"]) -> Float[Array, "b n c"]:
        matrix = self.head(jax.vmap(partial(pool_points, mean=False))(self.points(x, mask), mask))
        matrix = matrix.reshape(-1, self.features, self.features)
        return x + jnp.einsum("bnc,bcd->bnd", x, matrix)


class PointNet(nnx.Module):
    """Input and feature alignment, shared layers 64, 64, 64, 128, 1,024, max pooling, 512, 256, C.

    Departures: lengths are divided by a constant instead of the cloud's own size; the input may be posed like ADGCNN's;
    the publication's extra loss that keeps the feature alignment orthogonal is left out. With pose "none" and 40
    classes it has the 3.5 million parameters of the publication.

    Args:
        num_classes: C.
        pose: Frame of the input, see `pose_clouds`.
        scale_mm: Length that becomes 1 at the input.
        dropout: Rate in the classifier.
    """

    def __init__(
        self,
        num_classes: int,
        *,
        pose: str = "cylinder",
        scale_mm: float = 20.0,
        dropout: float = 0.3,
        rngs: nnx.Rngs,
    ):
        self.pose: str = pose
        self.scale_mm = scale_mm
        channels = pose_channels(pose)
        self.align_input = Alignment(channels, rngs=rngs)
        self.low = PointLayers(channels, (64, 64), rngs=rngs)
        self.align_features = Alignment(64, rngs=rngs)
        self.high = PointLayers(64, (64, 128, 1024), rngs=rngs)
        self.classifier = Classifier(1024, (512, 256), num_classes, dropout=dropout, negative_slope=0.0, rngs=rngs)

    def __call__(self, xyz: Float[Array, "b n 3"], mask: Bool[Array, "b n"]) -> Float[Array, "b classes"]:
        """Logits `[b, C]` of clouds in mm; rows where `mask` is False change nothing."""
        x = pose_clouds(xyz, mask, pose=self.pose, scale_mm=self.scale_mm).features
        x = self.low(self.align_input(x, mask), mask)
        x = self.high(self.align_features(x, mask), mask)
        return self.classifier(jax.vmap(partial(pool_points, mean=False))(x, mask))
