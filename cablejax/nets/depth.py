"""A depth image of a cloud at metric scale: what the image networks are shown."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from cablejax.ops.cylinder import principal_frame


def depth_image(
    xyz: Float[Array, "n 3"], mask: Bool[Array, " n"], *, size: int, extent_mm: float
) -> Float[Array, "size size"]:
    """Look at a cloud along +z, orthographically: each pixel keeps its nearest point.

    A pixel is `extent_mm / size` wide for every cloud, so size in mm stays size in pixels. Points outside the square
    are cut off.

    Args:
        xyz: Points in mm `[n, 3]`, centred.
        mask: True where a row is a point `[n]`.
        size: Pixels along x (columns) and y (rows). Static.
        extent_mm: Width of the square, and depth of the range that is told apart.

    Returns:
        `[size, size]`: 0 where there is no point, else 1/255 (farthest) to 1 (nearest).

    Raises:
        ValueError: If `size` is below 1.

    Example:
        >>> image = depth_image(jnp.zeros((1, 3)), jnp.ones(1, dtype=bool), size=3, extent_mm=30.0)
        >>> float(image[1, 1]), float(image.sum())
        (0.5, 0.5)
    """
    if size < 1:
        raise ValueError(f"size: expected at least 1, got {size}")
    pixel = jnp.floor((xyz[:, :2] / extent_mm + 0.5) * size).astype(jnp.int32)
    inside = mask & jnp.all((pixel >= 0) & (pixel < size), axis=1)
    nearness = jnp.clip(0.5 - xyz[:, 2] / extent_mm, 1.0 / 255.0, 1.0)
    flat = jnp.where(inside, pixel[:, 1] * size + pixel[:, 0], size * size)
    image = jnp.zeros(size * size).at[flat].max(jnp.where(inside, nearness, 0.0), mode="drop")
    return image.reshape(size, size)


def render(
    xyz: Float[Array, "b n 3"], mask: Bool[Array, "b n"], *, size: int, extent_mm: float
) -> Float[Array, "b size size 1"]:
    """Depth images of clouds turned to their principal axes: the cable lies along x, its convex side to the viewer."""

    def one(points: Float[Array, "n 3"], valid: Bool[Array, " n"]) -> Float[Array, "size size"]:
        centroid, rotation = principal_frame(points, valid)
        return depth_image((points - centroid[None, :]) @ rotation.T, valid, size=size, extent_mm=extent_mm)

    return jax.lax.stop_gradient(jax.vmap(one)(xyz, mask))[..., None]
