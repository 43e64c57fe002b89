"""ADGCNN's edge convolutions say which points are the cable's, a cylinder is fitted to those, and both tell the size."""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import nnx
from jaxtyping import Array, Bool, Float

from cablejax.nets.head import Classifier
from cablejax.nets.input_channels import RADIUS_MM, RADIUS_SPREAD_MM
from cablejax.nets.part_network import PartNetwork, local_shape
from cablejax.ops.weighted_cylinder import WeightedCylinder, principal_axes, weighted_cylinder

NU = 5.0  # degrees of freedom of the fit's error: Student's t, for some fits are far off
LEAST_STD_MM = 0.05
SHARPNESS = (
    2  # power of the scores in the weights: many points of a wall, each taken for the cable's with 5 %, bend a fit
)
SUMMARY = 7


class FitEstimate(NamedTuple):
    """What the network says of clouds.

    Attributes:
        logits: Of the C sizes `[b, C]`; log-probabilities up to a constant.
        diameter_mm: Of the fitted cylinder, moved by what the network has learnt of the fit's bias `[b]`.
        std_mm: Scale of its error, see `ADGCNNFit` `[b]`.
        scores: Logit of each point to be the cable's `[b, n]`.
    """

    logits: Float[Array, "b classes"]
    diameter_mm: Float[Array, " b"]
    std_mm: Float[Array, " b"]
    scores: Float[Array, "b n"]


class ADGCNNFit(nnx.Module):
    """Tell a cable's size by a cylinder fitted to the points that the network takes for the cable's.

    Each point gets a score s between 0 and 1 from edge convolutions with channel attention (`PartNetwork` with the two
    parts "something else" and "cable"). `weighted_cylinder` fits a gently bent cylinder with the weights s^2 and gives a
    diameter d with a standard deviation by its residuals. A head that sees the cloud's pooled feature and how the points
    lie on the cylinder gives a shift, an inflation of the standard deviation, and logits h_c of its own. With the nominal
    diameters D_c the logits are `h_c + log t((d + shift - D_c) / std)`, t being Student's density of 5 degrees of
    freedom: the product of what the fit and what the head say. At the start shift and h_c are 0.

    Everything is trained together, `scores` against the points' labels (`Split.on_cable`), the logits against the sizes.

    Args:
        num_classes: C.
        diameters_mm: Nominal diameter of each class `[C]`.
        k: Neighbours per point in every graph, the point itself counted.
        attention: Channel attention, eq. (12).
        widths: Channels of the edge convolutions.
        shared_width: Channels of the shared layer before pooling.
        point_head: Channels of the layers that score the points.
        head: Channels of the size head's hidden layers.
        scale_mm: Length that becomes 1 at the input.
        iterations: Gauss-Newton steps of the fit.
        most_points: Points that are scored at a time, for the neighbourhoods to be as dense as in training: of a cloud of
            g times as many rows (padding counts) every g-th one makes a cloud of its own. The cylinder is fitted to all.
    """

    def __init__(
        self,
        num_classes: int,
        *,
        diameters_mm: Sequence[float],
        k: int = 16,
        attention: bool = True,
        widths: Sequence[int] = (32, 32, 64),
        shared_width: int = 128,
        point_head: Sequence[int] = (64, 32),
        head: Sequence[int] = (64,),
        scale_mm: float = 20.0,
        iterations: int = 12,
        most_points: int = 512,
        rngs: nnx.Rngs,
    ):
        if len(diameters_mm) != num_classes:
            raise ValueError(f"diameters_mm: expected one of each of {num_classes} classes, got {len(diameters_mm)}")
        self.diameters_mm = tuple(float(each) for each in diameters_mm)
        self.scale_mm = scale_mm
        self.iterations = iterations
        self.most_points = most_points
        options = {"k": k, "attention": attention, "widths": widths, "shared_width": shared_width}
        self.points = PartNetwork(2, **options, head=point_head, scale_mm=scale_mm, rngs=rngs)
        self.head = Classifier(2 * shared_width + SUMMARY, tuple(head), num_classes + 2, rngs=rngs)
        self.head.logits.kernel[...] = jnp.zeros_like(self.head.logits.kernel[...])

    def __call__(self, xyz: Float[Array, "b n 3"], mask: Bool[Array, "b n"]) -> Float[Array, "b classes"]:
        """Logits `[b, C]` of clouds in mm; rows where `mask` is False change nothing."""
        return self.estimate(xyz, mask).logits

    def estimate(self, xyz: Float[Array, "b n 3"], mask: Bool[Array, "b n"]) -> FitEstimate:
        """Logits with the diameter, its standard deviation and the points' scores."""
        scores, pooled = self._scored(xyz, mask)
        weight = jnp.where(mask, jax.nn.sigmoid(scores) ** SHARPNESS, 0.0)
        fit = jax.vmap(lambda points, w: weighted_cylinder(points, w, iterations=self.iterations))(xyz, weight)
        found = fit.status == 0
        diameter = jnp.where(found, 2.0 * fit.radius, 2.0 * RADIUS_MM)
        std = jnp.where(found, 2.0 * fit.std, 2.0 * RADIUS_SPREAD_MM)
        said = self.head(jnp.concatenate([pooled, self._summary(fit, diameter, std, mask)], axis=1))
        diameter = diameter + said[:, -2]
        std = jnp.sqrt((std * jnp.exp(said[:, -1])) ** 2 + LEAST_STD_MM**2)
        off = (diameter[:, None] - jnp.asarray(self.diameters_mm)[None, :]) / std[:, None]
        by_fit = -0.5 * (NU + 1.0) * jnp.log1p(off**2 / NU)
        return FitEstimate(said[:, :-2] + by_fit, diameter, std, scores)

    def _scored(self, xyz: Array, mask: Array) -> tuple[Float[Array, "b n"], Float[Array, "b pooled"]]:
        """Scores of all points, 0 on padding, and the feature of each cloud, `most_points` at a time."""
        (b, n), deals = mask.shape, -(-mask.shape[1] // self.most_points)
        missing = -n % deals

        def deal(rows: Array) -> Array:
            padded = jnp.pad(rows, ((0, 0), (0, missing)) + ((0, 0),) * (rows.ndim - 2))
            return jnp.swapaxes(padded.reshape(b, -1, deals, *rows.shape[2:]), 1, 2).reshape(
                b * deals, -1, *rows.shape[2:]
            )

        dealt = deal(mask)
        labelled, pooled = self.points.label(jax.lax.stop_gradient(jax.vmap(self._inputs)(deal(xyz), dealt)), dealt)
        scores = jnp.where(dealt, labelled[..., 1] - labelled[..., 0], 0.0)
        scores = jnp.swapaxes(scores.reshape(b, deals, -1), 1, 2).reshape(b, -1)[:, :n]
        return scores, jnp.mean(pooled.reshape(b, deals, -1), axis=1)

    def _inputs(self, xyz: Array, mask: Array) -> Float[Array, "n c"]:
        """Coordinates along the cloud's principal axes in scales, and the local shape."""
        centroid, rotation = principal_axes(xyz, mask.astype(xyz.dtype))
        posed = jnp.where(mask[:, None], xyz - centroid[None, :], 0.0) @ rotation.T
        return jnp.concatenate([posed / self.scale_mm, local_shape(xyz, mask)], axis=1)

    def _summary(self, fit: WeightedCylinder, diameter: Array, std: Array, mask: Array) -> Float[Array, "b c"]:
        """How the points lie on the cylinder, in numbers of about 1 `[b, 7]`."""
        found = (fit.status == 0).astype(diameter.dtype)
        numbers = [
            jnp.tanh((diameter - 2.0 * RADIUS_MM) / (4.0 * RADIUS_SPREAD_MM)),
            jnp.log(std),
            jnp.log(fit.noise + 1e-3),
            fit.points / jnp.maximum(jnp.sum(mask, axis=1), 1),
            fit.length / (2.0 * self.scale_mm),
            4.0 * fit.mean_direction - 3.0,
        ]
        return jnp.stack([found * each for each in numbers] + [found], axis=1)
