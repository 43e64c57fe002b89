"""A depth image of a cloud at metric scale: what the image networks are shown."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from cablejax.ops.cylinder import principal_frame

Size = int | Sequence[int]


def sides(size: Size) -> tuple[int, int]:
    """Rows and columns of an image, given as one number where it is a square.

    Raises:
        ValueError: If it is neither one nor two numbers, or one is below 1.
    """
    rows, columns = (size, size) if isinstance(size, int) else size if len(size) == 2 else (0, 0)
    if min(rows, columns) < 1:
        raise ValueError(f"size: expected at least 1, or rows and columns of at least 1, got {size}")
    return rows, columns


def depth_image(
    xyz: Float[Array, "n 3"], mask: Bool[Array, " n"], *, size: Size, extent_mm: float
) -> Float[Array, "rows columns"]:
    """Look at a cloud along +z, orthographically: each pixel keeps its nearest point.

    A pixel is `extent_mm / columns` wide and high for every cloud, so size in mm stays size in pixels. Points outside the
    image are cut off.

    Args:
        xyz: Points in mm `[n, 3]`, centred.
        mask: True where a row is a point `[n]`.
        size: Pixels along y (rows) and x (columns), or one number for both. Static.
        extent_mm: Width of the image. Depths are told apart over a range as deep as its shorter side.

    Returns:
        `[rows, columns]`: 0 where there is no point, else 1/255 (farthest) to 1 (nearest).

    Raises:
        ValueError: If a side is below 1.

    Example:
        >>> image = depth_image(jnp.zeros((1, 3)), jnp.ones(1, dtype=bool), size=3, extent_mm=30.0)
        >>> float(image[1, 1]), float(image.sum())
        (0.5, 0.5)
    """
    rows, columns = sides(size)
    middle, most = jnp.array([columns, rows]) / 2, jnp.array([columns, rows])
    pixel = jnp.floor(xyz[:, :2] / extent_mm * columns + middle[None, :]).astype(jnp.int32)
    inside = mask & jnp.all((pixel >= 0) & (pixel < most[None, :]), axis=1)
    depth_mm = extent_mm * min(rows, columns) / columns
    nearness = jnp.clip(0.5 - xyz[:, 2] / depth_mm, 1.0 / 255.0, 1.0)
    flat = jnp.where(inside, pixel[:, 1] * columns + pixel[:, 0], rows * columns)
    image = jnp.zeros(rows * columns).at[flat].max(jnp.where(inside, nearness, 0.0), mode="drop")
    return image.reshape(rows, columns)


def render(
    xyz: Float[Array, "b n 3"], mask: Bool[Array, "b n"], *, size: Size, extent_mm: float
) -> Float[Array, "b rows columns 1"]:
    """Depth images of clouds turned to their principal axes: the cable lies along x, its convex side to the viewer."""

    def one(points: Float[Array, "n 3"], valid: Bool[Array, " n"]) -> Float[Array, "rows columns"]:
        centroid, rotation = principal_frame(points, valid)
        return depth_image((points - centroid[None, :]) @ rotation.T, valid, size=size, extent_mm=extent_mm)

    return jax.lax.stop_gradient(jax.vmap(one)(xyz, mask))[..., None]
