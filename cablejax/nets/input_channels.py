"""What a network is told about a cloud: its coordinates, in which frame, at one fixed metric scale."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from cablejax.ops.cylinder import cylinder_frame, principal_frame

POSES = ("none", "principal", "cylinder")
# Middle and spread of the radii of the catalogue's cables (10.6 to 22.8 mm). The radius tells the size, and sizes are 0.6
# to 1.6 mm of radius apart: beside coordinates of several scales it would drown.
RADIUS_MM = 16.5
RADIUS_SPREAD_MM = 4.0


class PosedClouds(NamedTuple):
    """Clouds ready for a network; lengths are divided by the scale, never by anything of the cloud itself.

    Attributes:
        features: Coordinates, and for the pose "cylinder" the radius as a fourth channel `[b, n, 3 or 4]`.
        axial: Position along the axis `[b, n]`, in scales. Axis and angle are those of the fitted cylinder for the pose
            "cylinder", of the principal frame for the others, which know of no fit.
        angle: Angle about the axis `[b, n]`, radians.
        radius: Distance from the cylinder's axis `[b, n]`, standardised by `RADIUS_MM` and `RADIUS_SPREAD_MM`; 0 on padding
            and where no cylinder was found. None for the poses without a fit.
    """

    features: Float[Array, "b n c"]
    axial: Float[Array, "b n"]
    angle: Float[Array, "b n"]
    radius: Float[Array, "b n"] | None


def pose_channels(pose: str) -> int:
    """Channels of `PosedClouds.features`.

    Raises:
        ValueError: If the pose is unknown.
    """
    if pose not in POSES:
        raise ValueError(f"pose: expected one of {', '.join(POSES)}, got {pose!r}")
    return 4 if pose == "cylinder" else 3


def pose_clouds(xyz: Float[Array, "b n 3"], mask: Bool[Array, "b n"], *, pose: str, scale_mm: float) -> PosedClouds:
    """Bring clouds into a frame and divide them by one constant.

    Args:
        xyz: Clouds in mm `[b, n, 3]`.
        mask: True where a row is a point `[b, n]`.
        pose: "none" centres; "principal" also turns to the principal axes; "cylinder" unbends the cable onto the
            cylinder fitted to it, so that its axis is x and its surface lies at its radius, and gives the radius as a
            channel, standardised. All three keep size, which is the label. Static.
        scale_mm: Length that becomes 1.
    """
    pose_channels(pose)
    if pose == "cylinder":
        frame = jax.vmap(cylinder_frame)(xyz, mask)
        axial, radius = frame.axial / scale_mm, frame.radius / scale_mm
        standard = jnp.where(frame.radius > 0, (frame.radius - RADIUS_MM) / RADIUS_SPREAD_MM, 0.0)
        across = [radius * jnp.cos(frame.angle), radius * jnp.sin(frame.angle)]
        return PosedClouds(jnp.stack([axial, *across, standard], axis=-1), axial, frame.angle, standard)
    centroid, rotation = jax.vmap(principal_frame)(xyz, mask)
    centred = jnp.where(mask[..., None], xyz - centroid[:, None, :], 0.0) / scale_mm
    turned = jnp.einsum("bni,bji->bnj", centred, rotation)
    still = jax.lax.stop_gradient(turned)  # as for the fit: where a point falls on the raster is not learnt
    angle = jnp.where(mask, jnp.arctan2(still[..., 1], still[..., 2]), 0.0)
    return PosedClouds(turned if pose == "principal" else centred, still[..., 0], angle, None)
