"""Errors that whole stretches of a scan share: stations that do not quite fit together.

The points of one station all carry the same shift. It does not average out, however many points there are. Where each
point's station is known the shifts are fitted along with the axis (`fit_cable`). Where it is not, what the shifts leave
in the residuals around the circumference is measured here and put into the uncertainty of the radius.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

BIN_DEG = 5.0
OVAL_DEG = 165.0  # of circumference, from which an oval section shows, and the shifts of stations tell on each other
GRAZING, FADE = 0.22, 0.05  # cosine of the incidence at which half of the points are missing, and how softly they fade
# Both from simulated scans whose sweeps are unknown, and all else is guessed.
LIKELIHOOD_POWER = (
    0.5  # power of the likelihoods: means of neighbouring directions err together and tell less than they seem to
)
WILD = 0.5  # of the scatter: a larger change of the radius comes from no shifts of stations, but from what is not round
UNSEEN = 1.6  # from half the circumference on the radius's error is this much larger than the guesses explain


class Profile(NamedTuple):
    """What shared errors mean for the radius.

    Attributes:
        std_mm: What they leave open in it: a standard deviation, noise not included.
        shared_mm: Standard deviation of the shared errors.
        change_mm: What they most likely have taken off the fitted radius; 0 where that cannot be told.
    """

    std_mm: float
    shared_mm: float
    change_mm: float


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


def _views(middle: np.ndarray) -> list[np.ndarray]:
    """Which stations may have seen what: for each guess, the share of every station in every direction `[stations, m]`.

    Two to six stations look from evenly spread sides over the arc that holds points, the outer ones half a step within
    its ends or at them; over the whole circumference they begin anywhere.
    """
    turned = np.sort(middle)
    gaps = np.diff(np.append(turned, turned[0] + 2 * np.pi))
    start = turned[(int(np.argmax(gaps)) + 1) % len(turned)]
    arc = 2 * np.pi - float(gaps.max())
    whole = arc > np.radians(330)
    views = []
    for count in (2, 3, 4, 6):
        inner = (np.arange(count) + 0.5) / count * arc
        starts = [inner + shift * 2 * np.pi / count for shift in (0, 0.25, 0.5, 0.75)]
        for place in starts if whole else [inner, np.arange(count) / (count - 1) * arc]:
            cosine = np.cos(middle[None, :] - start - place[:, None])  # of the incidence: points thin out with it
            seen = np.maximum(cosine, 0.0) / (1 + np.exp((GRAZING - cosine) / FADE))
            if (seen.sum(axis=0) > 1e-6).all():
                views.append(seen / seen.sum(axis=0))
    return views


def _generalised(values: np.ndarray, columns: np.ndarray, covariance: np.ndarray) -> tuple[float, float, float]:
    """Generalised least squares: restricted log likelihood, the first coefficient and its variance."""
    factor = np.linalg.cholesky(covariance)
    white, wide = np.linalg.solve(factor, values), np.linalg.solve(factor, columns)
    information = wide.T @ wide
    inverse = np.linalg.inv(information)
    found = inverse @ (wide.T @ white)
    left = white - wide @ found
    determinant = np.log(np.diag(factor)).sum() + 0.5 * np.linalg.slogdet(information)[1]
    return float(-0.5 * (left @ left) - determinant), float(found[0]), float(inverse[0, 0])


def shared_errors(
    angle: Float[np.ndarray, " n"],
    residual_mm: Float[np.ndarray, " n"],
    weight: Float[np.ndarray, " n"],
    *,
    given_std_mm: float = 0.0,
) -> Profile | None:
    """Estimate the errors that neighbouring directions share, and what they do to the radius.

    The mean residual over the angle is a circle's change (radius and centre) plus the shift of each station, projected
    on the normal, wherever that station sees the surface. How many stations there were, where they stood and how far
    they were shifted is not known: guesses of all are weighed by their restricted likelihood (to the power
    `LIKELIHOOD_POWER`), beside none at all and an oval section. What they change in the radius is doubted in full,
    since all may be wrong; and on arcs
    shorter than `OVAL_DEG`, where the data hardly tell them apart, it is not taken off.

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
    noise = float(np.sqrt(np.sum(weight * residual_mm**2) / weight.sum()))
    # The scatter holds the shifts as well, so they are no larger.
    sizes = [given_std_mm] if given_std_mm > 0 else np.geomspace(0.1, 1.0, 10) * noise
    cos = np.cos(middle[:, None] - middle[None, :])
    views = _views(middle)
    guesses = [(0.0, 1.0, np.zeros_like(cos))] if given_std_mm == 0 or not views else []
    for view in views:
        guesses += [(size, 1 / len(views) / len(sizes), size**2 * cos * (view.T @ view)) for size in sizes]
    # An oval section is no error: without guesses of its own it would pass for shifted stations. A short arc is taken
    # for round.
    wide = BIN_DEG * len(middle) >= OVAL_DEG
    ovals = np.geomspace(0.1, 30.0, 20 if wide else 0) * noise
    twice = np.cos(2 * (middle[:, None] - middle[None, :]))
    guesses += [(0.0, 1 / len(ovals), amplitude**2 * twice) for amplitude in ovals]
    floor = np.diag(variance + 1e-9 * noise**2)
    found = np.array([_generalised(mean, columns, floor + shared) for _, _, shared in guesses])
    size, prior = np.array([guess[:2] for guess in guesses]).T
    share = prior * np.exp(LIKELIHOOD_POWER * (found[:, 0] - found[:, 0].max()))
    share = share / share.sum()
    change = float(share @ found[:, 1])
    spread = float(share @ (found[:, 2] + (found[:, 1] - change) ** 2))
    left = max(spread - _generalised(mean, columns, floor)[2], 0.0)
    shared = float(np.sqrt(share @ size**2))
    std = float(np.hypot((UNSEEN if wide else 1.0) * np.sqrt(left), change))
    return Profile(std, shared, change if wide and abs(change) < WILD * noise else 0.0)
