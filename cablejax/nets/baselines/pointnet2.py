"""PointNet++ (Qi et al. 2017b), the single-scale classification network, on the cloud's points."""

from collections.abc import Sequence
from functools import partial

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Bool, Float, Int

from cablejax.nets.baselines.pointnet import PointLayers
from cablejax.nets.head import Classifier, pool_points
from cablejax.nets.input_channels import pose_clouds
from cablejax.ops.maximum import largest


def farthest_points(xyz: Float[Array, "n 3"], mask: Bool[Array, " n"], *, m: int) -> Int[Array, " m"]:
    """Rows of m points spread over a cloud: each the farthest from those before, the first from the centroid.

    The publication starts at a random point; this start does not depend on the points' order. With fewer than m valid
    points some come again.

    Example:
        >>> farthest_points(jnp.array([[0.0, 0, 0], [1, 0, 0], [9, 0, 0]]), jnp.ones(3, dtype=bool), m=2).tolist()
        [2, 0]
    """
    centroid = jnp.sum(xyz, axis=0, where=mask[:, None]) / jnp.maximum(jnp.sum(mask), 1)

    def sq_dist(point: Float[Array, "3"]) -> Float[Array, " n"]:
        return jnp.where(mask, jnp.sum((xyz - point[None, :]) ** 2, axis=1), -1.0)

    def choose(nearest: Float[Array, " n"], _: None) -> tuple[Float[Array, " n"], Int[Array, ""]]:
        row = jnp.argmax(nearest).astype(jnp.int32)
        return jnp.minimum(nearest, sq_dist(xyz[row])), row

    first = jnp.argmax(sq_dist(centroid)).astype(jnp.int32)
    rows = jax.lax.scan(choose, sq_dist(xyz[first]), None, length=m - 1)[1]
    return jnp.concatenate([first[None], rows])


def ball_neighbors(
    xyz: Float[Array, "n 3"], centers: Float[Array, "m 3"], mask: Bool[Array, " n"], *, radius: float, k: int
) -> Int[Array, "m k"]:
    """Rows of the k nearest points within a radius of each centre; the nearest one in place of those that are missing."""
    sq_dist = jnp.sum((centers[:, None, :] - xyz[None, :, :]) ** 2, axis=2)
    negative, rows = jax.lax.top_k(-jnp.where(mask[None, :], sq_dist, jnp.inf), k)
    return jnp.where(-negative <= radius**2, rows, rows[:, :1])


def pose_of_points(pose: str) -> str:
    """The frame of a network whose input is the coordinates alone, without what a fitted cylinder would add.

    Raises:
        ValueError: If it is neither "none" nor "principal".
    """
    if pose not in ("none", "principal"):
        raise ValueError(f"pose: expected none or principal, got {pose!r}")
    return pose


class SetAbstraction(nnx.Module):
    """Choose m points, gather the neighbours of each, and pool shared layers of them.

    Args:
        in_features: Channels that come with the points, coordinates not counted.
        widths: Channels of the shared layers.
        m: Points chosen.
        radius: Of a neighbourhood, in the unit of the points.
        k: Neighbours at most.
    """

    def __init__(self, in_features: int, widths: Sequence[int], *, m: int, radius: float, k: int, rngs: nnx.Rngs):
        self.m, self.radius, self.k = m, radius, k
        self.layers = PointLayers(in_features + 3, widths, rngs=rngs)

    def __call__(
        self, xyz: Float[Array, "b n 3"], features: Float[Array, "b n c"] | None, mask: Bool[Array, "b n"]
    ) -> tuple[Float[Array, "b m 3"], Float[Array, "b m d"]]:
        """The chosen points and their features."""
        rows = jax.vmap(partial(farthest_points, m=self.m))(*jax.lax.stop_gradient((xyz, mask)))
        centers = jnp.take_along_axis(xyz, rows[..., None], axis=1)
        ball = partial(ball_neighbors, radius=self.radius, k=self.k)
        neighbors = jax.vmap(ball)(*jax.lax.stop_gradient((xyz, centers, mask)))
        grouped = jax.vmap(lambda cloud, own: cloud[own])(xyz, neighbors) - centers[:, :, None, :]
        if features is not None:
            others = jax.vmap(lambda cloud, own: cloud[own])(features, neighbors)
            grouped = jnp.concatenate([grouped, others], axis=-1)
        b, m, k, c = grouped.shape
        layered = self.layers(grouped.reshape(b, m * k, c), jnp.ones((b, m * k), dtype=bool))
        return centers, largest(layered.reshape(b, m, k, -1), 2)


class PointNet2(nnx.Module):
    """512 neighbourhoods (64, 64, 128), 128 of those (128, 128, 256), all (256, 512, 1,024), then 512, 256, C.

    Departures: lengths are divided by a constant instead of the cloud's own size, so radii are in mm; sampling starts at
    the point farthest from the centroid; neighbours are the nearest ones in the ball. With 40 classes it has the 1.5
    million parameters of the publication.

    Args:
        num_classes: C.
        pose: Frame of the input, "none" or "principal".
        scale_mm: Length that becomes 1 at the input.
        points: Points chosen by the first two stages.
        radii_mm: Their neighbourhoods.
        neighbors: Neighbours in each, at most.
        dropout: Rate in the classifier.
    """

    def __init__(
        self,
        num_classes: int,
        *,
        pose: str = "principal",
        scale_mm: float = 20.0,
        points: tuple[int, int] = (512, 128),
        radii_mm: tuple[float, float] = (8.0, 16.0),
        neighbors: tuple[int, int] = (32, 64),
        dropout: float = 0.5,
        rngs: nnx.Rngs,
    ):
        self.pose = pose_of_points(pose)
        self.scale_mm = scale_mm
        radii = [each / scale_mm for each in radii_mm]
        self.first = SetAbstraction(0, (64, 64, 128), m=points[0], radius=radii[0], k=neighbors[0], rngs=rngs)
        self.second = SetAbstraction(128, (128, 128, 256), m=points[1], radius=radii[1], k=neighbors[1], rngs=rngs)
        self.last = PointLayers(256 + 3, (256, 512, 1024), rngs=rngs)
        self.classifier = Classifier(1024, (512, 256), num_classes, dropout=dropout, negative_slope=0.0, rngs=rngs)

    def __call__(self, xyz: Float[Array, "b n 3"], mask: Bool[Array, "b n"]) -> Float[Array, "b classes"]:
        """Logits `[b, C]` of clouds in mm; rows where `mask` is False change nothing."""
        points = pose_clouds(xyz, mask, pose=self.pose, scale_mm=self.scale_mm).features
        points, features = self.first(points, None, mask)
        everywhere = jnp.ones(points.shape[:2], dtype=bool)
        points, features = self.second(points, features, everywhere)
        everywhere = jnp.ones(points.shape[:2], dtype=bool)
        x = self.last(jnp.concatenate([points, features], axis=-1), everywhere)
        return self.classifier(jax.vmap(partial(pool_points, mean=False))(x, everywhere))
