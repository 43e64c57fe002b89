"""Poses of training clouds: a rotation, and a canonical one from the estimated axis."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from cablejax.ops.cylinder import principal_frame


def rotation_of(quaternion: Float[Array, " 4"]) -> Float[Array, "3 3"]:
    """Rotation matrix of a quaternion of any length; standard normal entries make it uniform over all rotations."""
    w, x, y, z = quaternion / jnp.linalg.norm(quaternion)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return jnp.stack([jnp.stack(row) for row in rows])


def centred(xyz: Float[Array, "n 3"], mask: Bool[Array, " n"]) -> Float[Array, "n 3"]:
    """The cloud moved so that its mean is the origin; padding becomes 0."""
    weight = mask[:, None] / jnp.maximum(jnp.sum(mask), 1)
    return jnp.where(mask[:, None], xyz - jnp.sum(xyz * weight, axis=0)[None, :], 0.0)


def canonical_pose(xyz: Float[Array, "n 3"], mask: Bool[Array, " n"]) -> Float[Array, "n 3"]:
    """Centre a cloud and turn its estimated axis to x. Lengths are kept.

    The axis is the direction of the largest variance, which is the cable's wherever the piece seen is longer than about
    1.5 diameters; z is the direction of the smallest variance. Their signs make the third moment positive; y follows
    from the right-hand rule. A cloud seen all round has no preferred y and z, and they stay as chance has them.
    """
    centroid, rotation = principal_frame(xyz, mask)
    return jnp.where(mask[:, None], (xyz - centroid[None, :]) @ rotation.T, 0.0)
