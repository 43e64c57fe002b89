"""How wide the adaptive filter's kernel should be, from the cloud alone: leave-one-out prediction at a few points.

A narrow kernel leaves noise, a wide one irons out the shape; how well neighbours predict a point that they do not include
falls and rises with it. Weights by distance in space would spoil the test: a point that noise has lifted chooses lifted
neighbours, predicts itself too well, and the narrowest kernel always wins. So the prediction weighs by distance in the
tangent plane, and what the kernel in space must be wider for the noise is added afterwards.
"""

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from cablejax.ops.factors import TINY
from cablejax.ops.moments import local_noise
from cablejax.ops.neighbors import knn
from cablejax.ops.precision import require_float32
from cablejax.ops.quantile import quantile
from cablejax.ops.sheets import own_sheet
from cablejax.ops.slots import Vector, farthest, offsets, sq_length
from cablejax.ops.surface_fit import SurfaceFit, fit_frame, fit_heights, flat_fit, residual, without_faint
from cablejax.types import PointCloud

PILOT = 2048  # points whose neighbours predict them
STEP = 1.25
SHARES = tuple(0.2 * STEP**i for i in range(12))  # widths tried, per local noise of eq. (3): 0.2 to 2.3
BAND = 3.0  # neighbours off the surface by so many deviations lose their say: another sheet, an outlier
LEAST = 0.2  # share that the others must have in a point's surface for it to count as a prediction
LIFT = 4.5  # see `choose_alpha`; chosen on five of the ten shapes of benchmarks/denoise.py


class Trial(NamedTuple):
    """How each width did at each pilot point.

    Attributes:
        loss: Squared distance of the point from its prediction `[widths, m]`, in the cloud's unit squared.
        noise: Standard deviation of its neighbours from their surface `[widths, m]`.
        local: Local noise of eq. (3) `[m]`; 0 where there is no point.
    """

    loss: Float[Array, "widths m"]
    noise: Float[Array, "widths m"]
    local: Float[Array, " m"]


@partial(jax.jit, static_argnames=("k", "order"))
def width_trial(cloud: PointCloud, keep: Bool[Array, " n"], rows: Int[Array, " m"], *, k: int, order: int) -> Trial:
    """What the estimate of `alpha` rests on, for some rows of a cloud; `choose_alpha` makes one number of it.

    For clouds that come in parts: the trials of all parts side by side are the trial of the whole, if together they hold
    the kept points whose places among all kept ones are `pilot_places`.

    Args:
        cloud: Points `[n, 3]` float32, any unit, with validity `[n]`.
        keep: Which of them are no outliers `[n]`: the neighbours are the kept ones among the k nearest of all.
        rows: Which to predict `[m]`; -1 for none.
        k: Neighbours per point, the point itself not counted. Static.
        order: 1 or 2. Static.

    Raises:
        ValueError: If `k` is below 1, `order` is neither 1 nor 2, or the points are not float32.
    """
    require_float32(cloud__xyz=cloud.xyz)
    if order not in (1, 2):
        raise ValueError(f"order: expected 1 or 2, got {order}")
    at = jnp.maximum(rows, 0)
    search = knn(cloud.xyz, k=k + 1, queries=cloud.xyz[at], mask=cloud.mask)
    near = search.neighbors.T
    used = (rows >= 0) & keep[at]
    near = jnp.where((near >= 0) & (near != rows[None]) & used[None] & keep[jnp.maximum(near, 0)], near, -1)
    neighbors = jnp.concatenate([jnp.where(used, rows, -1)[None], near])
    xyz = jnp.where(cloud.mask[:, None] & jnp.isfinite(cloud.xyz), cloud.xyz, 0.0).T
    centre = xyz[:, at]
    neighbors = own_sheet(xyz, centre, neighbors, local_noise(xyz, centre, neighbors))
    local = local_noise(xyz, centre, neighbors)
    return try_widths(xyz, centre, neighbors, jnp.where(used, local, 0.0), order=order)


def pilot_places(count: Int[Array, ""] | int) -> Int[Array, " m"]:
    """Which of the `count` points of a cloud, counted without its padding and outliers, are predicted.

    Returns:
        Places from 0 `[PILOT]`, evenly apart; -1 for those beyond the last where there are fewer points.
    """
    i, count = jnp.arange(PILOT), jnp.asarray(count)
    even = i * (count // PILOT) + i * (count % PILOT) // PILOT  # i * count // PILOT, without overflow
    return jnp.where(count >= PILOT, even, jnp.where(i < count, i, -1))


def pilot_rows(valid: Bool[Array, " n"]) -> Int[Array, " m"]:
    """Rows of the points that are predicted `[min(n, PILOT)]`, -1 for none: the same points however a cloud is padded."""
    place = pilot_places(valid.sum())[: valid.shape[0]]
    row = jnp.searchsorted(jnp.cumsum(valid), place + 1)
    return jnp.where(place >= 0, row, -1)


def try_widths(
    xyz: Float[Array, "3 n"],
    centre: Float[Array, "3 m"],
    neighbors: Int[Array, "k m"],
    local: Float[Array, " m"],
    *,
    order: int,
) -> Trial:
    """Predict some points of a cloud from their neighbours with each of the widths.

    Args:
        xyz: Coordinates `[3, n]`.
        centre: The points to predict `[3, m]`, their rows first in `neighbors`.
        neighbors: Rows of each one's neighbours `[k, m]`, -1 where there is none.
        local: Local noise of eq. (3) `[m]`, 0 where there is no point.
        order: 1 for planes, 2 for quadrics. Static.
    """
    shares, count = jnp.asarray(SHARES, dtype=xyz.dtype), len(SHARES)
    width = (shares[:, None] * local[None]).reshape(-1)
    loss, noise = _predict(xyz, jnp.tile(neighbors, (1, count)), jnp.tile(centre, (1, count)), width, order)
    return Trial(loss.reshape(count, -1), noise.reshape(count, -1), local)


def _predict(xyz: Array, neighbors: Array, centre: Array, width: Array, order: int) -> tuple[Array, Array]:
    """Squared leave-one-out error and noise at each centre `[m]`."""
    scale = 0.5 / jnp.square(jnp.where(width > 0, width, 1.0))

    def in_space(rows: Array, near: Array) -> tuple[Array, Vector]:
        offset = offsets(xyz, rows, centre)
        return without_faint(jnp.where(near, jnp.exp(-sq_length(offset) * scale), 0.0)), offset

    frame = fit_frame(in_space, neighbors)
    reach = farthest(xyz, centre, neighbors)

    def about(fit: SurfaceFit) -> Array:
        """Weight, per squared distance from a surface."""
        return 0.5 / jnp.square(BAND * jnp.maximum(fit.noise, TINY**0.25))

    def turn(number: Array, fits: tuple[SurfaceFit, SurfaceFit]) -> tuple[SurfaceFit, SurfaceFit]:
        """First in space, which is the same beside the plane through the centre; then in the plane beside that surface."""
        _, last = fits
        off_surface = residual(last)
        # The k nearest in space of a lifted point are, at the rim, lifted ones alone: in the plane, only what no lift excludes.
        rim = jnp.maximum(reach - jnp.square(BAND * last.noise), 0.25 * reach)
        rim, band = jnp.where(number == 0, jnp.inf, rim), jnp.where(number == 0, scale, about(last))

        def beside(rows: Array, near: Array) -> tuple[Array, Vector]:
            offset = offsets(xyz, rows, centre)
            off, sq_dist = off_surface(offset)
            inside = near & (sq_dist <= rim)
            return without_faint(jnp.where(inside, jnp.exp(-sq_dist * scale - jnp.square(off) * band), 0.0)), offset

        return last, fit_heights(beside, neighbors, frame, order=order)

    flat = flat_fit(frame, order=order)
    pilot, fit = lax.fori_loop(0, 2, turn, (flat, flat))
    band = about(pilot)
    # The own weight falls with the own residual alone; without its share, the height is what the others predict.
    others = 1.0 - jnp.exp(-jnp.square(pilot.height) * band) * fit.leverage
    loss = jnp.square(fit.height / jnp.maximum(others, LEAST))
    # A kernel that holds hardly more than the point itself gives it back and predicts nothing: as bad as its width.
    return jnp.where(others < LEAST, jnp.square(width), loss), pilot.noise


def choose_alpha(trial: Trial) -> Float[Array, ""]:
    """The share alpha of the local noise that eq. (5) takes for the width.

    The best width t of the prediction, between the tried ones by a parabola. In space, a point displaced by e finds a
    surface lifted by e s^2 / (s^2 + w^2), with noise s and width w, so the width is taken larger where the noise is no
    longer small against it: w^2 = t^2 + LIFT s^4 / t^2.

    Args:
        trial: From `try_widths` or `width_trial`.

    Returns:
        alpha, a constant to gradients; 1 where the trial holds no point.
    """
    trial = lax.stop_gradient(trial)
    used = trial.local > 0
    shares = jnp.asarray(SHARES, dtype=trial.loss.dtype)
    relative = jnp.where(used[None], trial.noise / jnp.where(used, trial.local, 1.0)[None], 0.0)
    noise = _quantile_of_each(relative, used, 0.5)
    mean = _mean_loss(trial.loss, used)
    # A kernel narrower than the noise holds points that noise lifted alike: it predicts them too well.
    mean = jnp.where(shares >= noise, mean, jnp.inf)
    best = jnp.clip(jnp.argmin(mean), 1, len(SHARES) - 2)
    place = _lowest(*(lax.dynamic_index_in_dim(mean, best + i, keepdims=False) for i in (-1, 0, 1)))
    share = jnp.exp((best.astype(shares.dtype) + place) * jnp.log(jnp.asarray(STEP, shares.dtype))) * SHARES[0]
    alpha = share * jnp.sqrt(1.0 + LIFT * (noise[best] / share) ** 4)
    return jnp.where(used.any(), alpha, 1.0)


def usual_noise(trial: Trial, alpha: Float[Array, ""]) -> Float[Array, ""]:
    """The noise that surfaces of the chosen width leave where the cloud is smooth: the 10th percentile, in its unit.

    The median would be that of the edges on a cloud that is mostly edges.
    """
    noise = _quantile_of_each(lax.stop_gradient(trial.noise), trial.local > 0, 0.1)
    return jnp.interp(jnp.log(alpha), jnp.log(jnp.asarray(SHARES, dtype=noise.dtype)), noise)


def _quantile_of_each(values: Float[Array, "widths m"], used: Array, q: float) -> Float[Array, " widths"]:
    return jax.vmap(lambda row: quantile(row, used, q))(values)


def _mean_loss(loss: Float[Array, "widths m"], used: Array) -> Float[Array, " widths"]:
    """Mean of each width's losses, less what 2,000 points cannot tell on the wide side of the best."""
    # One point in a hundred may be as far off as it likes: an edge, a stray.
    loss = jnp.where(used[None], jnp.minimum(loss, _quantile_of_each(loss, used, 0.99)[:, None]), 0.0)
    count = jnp.maximum(used.sum(), 1).astype(loss.dtype)
    mean = loss.sum(axis=1) / count
    least = jnp.argmin(mean)
    # Where wide kernels predict as well as can be told, the widest of them: it leaves the least noise.
    beyond = loss - lax.dynamic_index_in_dim(loss, least)
    off_mean = jnp.where(used[None], beyond - (beyond.sum(axis=1) / count)[:, None], 0.0)
    doubt = jnp.sqrt(jnp.square(off_mean).sum(axis=1)) / count
    return mean - jnp.where(jnp.arange(len(SHARES)) > least, doubt, 0.0)


def _lowest(left: Array, middle: Array, right: Array) -> Float[Array, ""]:
    """Where the parabola through three losses is lowest, -1 to 1; the first may be infinite."""
    left = jnp.where(jnp.isfinite(left), left, middle + jnp.abs(right - middle))
    curve = left - 2.0 * middle + right
    bent = curve > 0
    place = jnp.where(bent, 0.5 * (left - right) / jnp.where(bent, curve, 1.0), jnp.sign(left - right))
    return jnp.clip(place, -1.0, 1.0)
