"""PointNeXt-S (Qian et al. 2022), the classification network, on the cloud's points."""

from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Bool, Float

from cablejax.nets.baselines.pointnet2 import ball_neighbors, farthest_points, pose_of_points
from cablejax.nets.head import Classifier, pool_points
from cablejax.nets.init import he_normal, lecun_normal
from cablejax.nets.input_channels import pose_clouds
from cablejax.nets.norm import BatchNorm
from cablejax.ops.maximum import largest


class PointNeXt(nnx.Module):
    """A layer of 32, four residual abstractions (64, 128, 256, 512), all points (512, 512), then 512, 256, C.

    PointNet++ with offsets measured in the neighbourhood's radius, a way around each abstraction, and twice the stages. Of its
    training recipe (AdamW, cosine, label smoothing, point resampling) nothing is in here: it trains as the others do.

    Departures: lengths are divided by a constant instead of the cloud's own size, so radii are in mm; the height above the
    ground is no input, as a cable has none; sampling starts at the point farthest from the centroid, and its numbers do not
    depend on the cloud's; neighbours are the nearest ones in the ball. With 15 classes it has the 1.4 million parameters of
    the publication.

    Args:
        num_classes: C.
        pose: Frame of the input, "none" or "principal".
        scale_mm: Length that becomes 1 at the input.
        points: Points chosen by the stages, each half of those before.
        radius_mm: Neighbourhood of the first stage; each has 1.5 times that of the one before.
        neighbors: Neighbours in each, at most.
        dropout: Rate in the classifier.
    """

    def __init__(
        self,
        num_classes: int,
        *,
        pose: str = "principal",
        scale_mm: float = 20.0,
        points: Sequence[int] = (512, 256, 128, 64),
        radius_mm: float = 6.0,
        neighbors: int = 32,
        dropout: float = 0.5,
        rngs: nnx.Rngs,
    ):
        self.pose = pose_of_points(pose)
        self.scale_mm = scale_mm
        widths = [32 * 2**stage for stage in range(len(points) + 1)]
        self.stem = NormedLinear(3, widths[0], rngs=rngs)
        self.stages = nnx.List(
            [
                ResidualAbstraction(
                    c, d, m=m, radius=radius_mm / scale_mm * 1.5**stage, k=min(neighbors, before), rngs=rngs
                )
                for stage, (c, d, m, before) in enumerate(
                    zip(widths[:-1], widths[1:], points, (neighbors, *points), strict=False)
                )
            ]
        )
        self.all = nnx.List(
            [NormedLinear(widths[-1] + 3, widths[-1], rngs=rngs), NormedLinear(widths[-1], widths[-1], rngs=rngs)]
        )
        self.classifier = Classifier(
            widths[-1], (512, 256), num_classes, dropout=dropout, negative_slope=0.0, rngs=rngs
        )

    def __call__(self, xyz: Float[Array, "b n 3"], mask: Bool[Array, "b n"]) -> Float[Array, "b classes"]:
        """Logits `[b, C]` of clouds in mm; rows where `mask` is False change nothing."""
        points = pose_clouds(xyz, mask, pose=self.pose, scale_mm=self.scale_mm).features
        x = jax.nn.relu(self.stem(points, mask))
        for stage in self.stages:
            points, x = stage(points, x, mask)
            mask = jnp.ones(points.shape[:2], dtype=bool)
        x = jnp.concatenate([points, x], axis=-1)
        for layer in self.all:
            x = jax.nn.relu(layer(x, mask))
        return self.classifier(jax.vmap(partial(pool_points, mean=False))(x, mask))


class NormedLinear(nnx.Module):
    """A layer shared by all points, without a bias, and batch normalisation over those that count."""

    def __init__(self, in_features: int, features: int, *, rngs: nnx.Rngs):
        self.linear = nnx.Linear(in_features, features, use_bias=False, kernel_init=he_normal, rngs=rngs)
        self.norm = BatchNorm(features)

    def __call__(self, x: Float[Array, "b ... c"], mask: Bool[Array, "b ..."]) -> Float[Array, "b ... d"]:
        return self.norm(self.linear(x), mask.astype(x.dtype))


class ResidualAbstraction(nnx.Module):
    """Choose m points, pool two layers over the neighbours of each, and add a layer of its own features.

    Args:
        in_features: Channels of the points.
        features: Channels of the result; the first layer has half of them.
        m: Points chosen.
        radius: Of a neighbourhood, in the unit of the points.
        k: Neighbours at most.
    """

    def __init__(self, in_features: int, features: int, *, m: int, radius: float, k: int, rngs: nnx.Rngs):
        self.m, self.radius, self.k = m, radius, k
        self.first = NormedLinear(in_features + 3, features // 2, rngs=rngs)
        self.second = NormedLinear(features // 2, features, rngs=rngs)
        self.around = nnx.Linear(in_features, features, kernel_init=lecun_normal, rngs=rngs)

    def __call__(
        self, xyz: Float[Array, "b n 3"], features: Float[Array, "b n c"], mask: Bool[Array, "b n"]
    ) -> tuple[Float[Array, "b m 3"], Float[Array, "b m d"]]:
        """The chosen points and their features."""
        rows = jax.vmap(partial(farthest_points, m=self.m))(*jax.lax.stop_gradient((xyz, mask)))
        centers = jnp.take_along_axis(xyz, rows[..., None], axis=1)
        ball = partial(ball_neighbors, radius=self.radius, k=self.k)
        neighbors = jax.vmap(ball)(*jax.lax.stop_gradient((xyz, centers, mask)))
        offset, others = (jax.vmap(lambda cloud, at: cloud[at])(each, neighbors) for each in (xyz, features))
        x = jnp.concatenate([(offset - centers[:, :, None, :]) / self.radius, others], axis=-1)
        everywhere = jnp.ones(x.shape[:3], dtype=bool)
        x = self.second(jax.nn.relu(self.first(x, everywhere)), everywhere)
        own = jnp.take_along_axis(features, rows[..., None], axis=1)
        return centers, jax.nn.relu(largest(x, 2) + self.around(own))
