"""Errors that whole stretches of a scan share: stations that do not quite fit together.

The points of one station all carry the same shift. It does not average out, however many points there are. Where each
point's station is known the shifts are fitted along with the axis (`fit_cable`). Where it is not, what the shifts leave
in the residuals around the circumference is measured here and put into the uncertainty of the radius.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

BIN_DEG = 7.5
STRETCH_DEG = 60.0  # a station sees some 120 degrees and fades out towards both sides


class Profile(NamedTuple):
    """What shared errors mean for the radius.

    Attributes:
        std_mm: Standard deviation of the fitted radius, noise included.
        shared_mm: Standard deviation of the shared errors.
    """

    std_mm: float
    shared_mm: float


def _binned(angle: np.ndarray, residual: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Middle angle, weighted mean residual and its variance, for every bin around the circumference with points."""
    count = int(360 / BIN_DEG)
    row = np.minimum(((np.degrees(angle) % 360) / BIN_DEG).astype(int), count - 1)
    total = np.bincount(row, weights=weight, minlength=count)
    keep = total > max(20.0, 0.02 * total.max())
    mean = np.bincount(row, weights=weight * residual, minlength=count)[keep] / total[keep]
    square = np.bincount(row, weights=weight * residual**2, minlength=count)[keep] / total[keep]
    middle = np.radians((np.flatnonzero(keep) + 0.5) * BIN_DEG)
    return middle, mean, np.maximum(square - mean**2, 1e-18) / total[keep]


def _evidence(values: np.ndarray, columns: np.ndarray, covariance: np.ndarray) -> float:
    """Restricted log likelihood of generalised least squares."""
    factor = np.linalg.cholesky(covariance)
    white, wide = np.linalg.solve(factor, values), np.linalg.solve(factor, columns)
    information = wide.T @ wide
    left = white - wide @ np.linalg.solve(information, wide.T @ white)
    determinant = np.log(np.diag(factor)).sum() + 0.5 * np.linalg.slogdet(information)[1]
    return float(-0.5 * (left @ left) - determinant)


def shared_errors(
    angle: Float[np.ndarray, " n"],
    residual_mm: Float[np.ndarray, " n"],
    weight: Float[np.ndarray, " n"],
    *,
    given_std_mm: float = 0.0,
) -> Profile | None:
    """Estimate the errors that neighbouring directions share, and what they do to the radius.

    The mean residual over the angle is a circle's change (radius and centre) plus a Gaussian process: a shift of a
    station shows as its projection on the normal, `cos` of the angle between, wherever the station sees the surface. The
    process's standard deviation is integrated over by restricted likelihood, so that one that cannot be told from zero
    still counts by how well it can be told.

    Args:
        angle: Of each point around the axis, radians.
        residual_mm: Distance from the surface.
        weight: Of the fit.
        given_std_mm: Standard deviation of the shifts where it is known; estimated from the profile if 0.

    Returns:
        None where fewer than six bins hold points.
    """
    middle, mean, variance = _binned(angle, residual_mm, weight)
    if len(middle) < 6:
        return None
    columns = np.stack([np.ones_like(middle), np.cos(middle), np.sin(middle)], axis=1)
    cos = np.cos(middle[:, None] - middle[None, :])
    kernel = cos * np.exp((cos - 1) / np.radians(STRETCH_DEG) ** 2)  # von Mises, so that it closes around the circle
    noise = float(np.sqrt(np.median(variance)))
    sizes = [given_std_mm] if given_std_mm > 0 else [0.0, *np.geomspace(0.3 * noise, 100 * noise, 36)]
    weighted = columns / variance[:, None]
    lever = np.linalg.solve(weighted.T @ columns, weighted.T)[0]  # how far each bin moves the fitted radius
    log, var = [], []
    for size in sizes:
        covariance = np.diag(variance) + size**2 * kernel + 1e-9 * noise**2 * np.eye(len(middle))
        log.append(_evidence(mean, columns, covariance))
        var.append(lever @ covariance @ lever)
    # Before the scan is looked at: none with a probability of one half, else any size, evenly on a log scale.
    prior = np.array([1.0, *np.full(len(sizes) - 1, 1 / max(len(sizes) - 1, 1))])
    share = prior * np.exp(np.array(log) - max(log))
    share = share / share.sum()
    return Profile(float(np.sqrt(share @ np.array(var))), float(np.sqrt(share @ np.square(sizes))))


def blocks(station: Int[np.ndarray, " n"], along_mm: Float[np.ndarray, " n"], *, pieces: int) -> Int[np.ndarray, " n"]:
    """A number for every station in every one of `pieces` equal stretches of the length, without gaps.

    A station's shift may differ from stretch to stretch: an arm drifts, a window is swept twice.
    """
    low, high = along_mm.min(), along_mm.max()
    piece = np.clip(((along_mm - low) / max(high - low, 1e-9) * pieces).astype(int), 0, pieces - 1)
    return np.unique(station * pieces + piece, return_inverse=True)[1].reshape(-1)
