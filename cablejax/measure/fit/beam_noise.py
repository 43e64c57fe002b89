"""Noise along the beam: it moves a point around the circle as well as off it, and so moves the fitted radius.

A range error e on a beam that meets the surface at incidence i leaves e cos(i) off the surface and e sin(i) along it. A
point moved along the surface by t lies t^2 / 2R outside; and since the points thin out with cos(i), those that noise has
brought to a place come more from the denser side, and lie outside for that as well. And since noise moves a point along
with its normal, a fit with free shifts follows it, and makes a short arc too small. Where the scanner is known, all of it is
found by scanning the fitted cable anew.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from cablejax.measure.fit.axis import Place, point_at
from cablejax.measure.fit.least_squares import CableFit

BIN_DEG = 5.0
LARGEST = np.radians(72.0)  # incidence; beyond, points are left out or too few to matter
BEAM_DOUBT = 0.3  # of the correction: jitter across the beam adds less, and noise need not grow as assumed
KNOWN_DOUBT = 0.2  # of the correction with a scanner's own numbers
RIM = 2.0  # standard deviations of the beam, its jitter included, that must lie on the cable for a point to count
LEAST_CLEAR = 0.5  # of the radius: where the beam is as wide as the cable, half of it is kept all the same
RESCANNED = 8_000  # points on which the noise is put anew
NODES = 7  # places in the footprint over which a range is averaged


@dataclass(frozen=True)
class Instrument:
    """What is known of a scanner.

    Attributes:
        range_std_mm: Standard deviation of a range at normal incidence, at the distance of the cable.
        incidence_power: That noise grows with cos(i)^-power.
        lateral_std_mm: Standard deviation of the beam's place across itself, at the cable.
        footprint_mm: Standard deviation of the beam's Gaussian footprint there; the 1/e2 diameter is four of these.
    """

    range_std_mm: float
    incidence_power: float = 1.0
    lateral_std_mm: float = 0.0
    footprint_mm: float = 0.0

    def __post_init__(self) -> None:
        for name in ("range_std_mm", "incidence_power", "lateral_std_mm", "footprint_mm"):
            value = getattr(self, name)
            if not 0 <= value < float("inf"):
                raise ValueError(f"{name}: expected a number of at least 0, got {value!r}")

    @property
    def rim_mm(self) -> float:
        """How near to the silhouette a beam may pass: nearer, its echo may be mixed with that of what lies behind."""
        return RIM * float(np.hypot(self.footprint_mm, self.lateral_std_mm))


def incidence(angle: Float[np.ndarray, " n"], sweep: Int[np.ndarray, " n"] | None) -> Float[np.ndarray, " n"] | None:
    """Signed angle in radians between each point's normal and the way to its scanner, around the axis `[n]`.

    Beams lie evenly across the view, so a sweep's points on a round surface thin out as the cosine of that angle: A cos +
    B sin is fitted to the numbers in bins of `BIN_DEG`, and points to the scanner. None where no direction stands out, or
    the sweeps are not known.
    """
    if sweep is None:
        return None
    count = int(360 / BIN_DEG)
    bins = np.minimum((np.degrees(angle) % 360 / BIN_DEG).astype(int), count - 1)
    middle = np.radians((np.arange(count) + 0.5) * BIN_DEG)
    columns = np.stack([np.cos(middle), np.sin(middle)], axis=1)
    out = np.empty(len(angle))
    for name in range(int(sweep.max()) + 1):
        rows = sweep == name
        density = np.bincount(bins[rows], minlength=count).astype(float)
        within = (density > 0.3 * np.sort(density)[-4:].mean()) & (np.roll(density, 1) > 0) & (np.roll(density, -1) > 0)
        if within.sum() < 3:
            return None
        ahead, *_ = np.linalg.lstsq(columns[within], density[within], rcond=None)
        if np.hypot(*ahead) < 0.5 * density[within].mean():
            return None
        out[rows] = angle[rows] - np.arctan2(ahead[1], ahead[0])
    return np.arctan2(np.sin(out), np.cos(out))


def clear_of_the_rim(
    place: Place, sweep: Int[np.ndarray, " n"] | None, *, radius_mm: float, instrument: Instrument
) -> Bool[np.ndarray, " n"]:
    """Which points `[n]` the scanner saw well inside the cable's silhouette, told by how far from its middle they lie.

    An echo mixed with what lies behind is too long, and so is moved along the beam: its distance from the middle of the
    silhouette stays, wherever it comes to lie. All points, where the directions of the beams are not known.
    """
    turned = incidence(np.arctan2(place.v, place.u), sweep)
    if turned is None:
        return np.ones(len(place.s), dtype=bool)
    aside = np.hypot(place.u, place.v) * np.abs(np.sin(turned))
    return (np.cos(turned) > 0) & (aside < max(radius_mm - instrument.rim_mm, LEAST_CLEAR * radius_mm))


class BeamBias(NamedTuple):
    """What the beams have done to a fitted diameter.

    Attributes:
        bias_mm: What they have added.
        doubt_mm: Its standard deviation.
        how: How it was come by, in words.
        excess: Scatter that was found over the one that the scanner's numbers give; None where they are not known. With
            them, the bias holds what is of third order in the noise too.
    """

    bias_mm: float
    doubt_mm: float
    how: str
    excess: float | None = None


def beam_bias(fit: CableFit, sweep: Int[np.ndarray, " n"] | None) -> BeamBias:
    """How much noise along the beams of an unknown scanner has enlarged the fitted diameter.

    With residuals of variance s^2 the points found at an angle lie s^2 / R (1 + tan^2(i) / 2) outside on average; each
    counts by its weight in the radius. Where the directions of the beams are not known, s^2 / R is taken.
    """
    angle = np.arctan2(fit.place.v, fit.place.u)
    turned = incidence(angle, sweep)
    square = 0.0 if turned is None else np.tan(np.clip(turned, -LARGEST, LARGEST)) ** 2
    bias = float(2 * fit.noise_mm**2 / fit.radius_mm * np.sum(fit.influence * (1 + 0.5 * square)))
    how = f"{100 * BEAM_DOUBT:.0f} % of the {bias:.2g} mm that were taken off for it"
    return BeamBias(bias, BEAM_DOUBT * abs(bias), how)


def rescanned(
    fit: CableFit,
    sweep: Int[np.ndarray, " n"] | None,
    refit: Callable[[Float[np.ndarray, "n 3"], Int[np.ndarray, " n"]], CableFit],
    rng: np.random.Generator,
) -> float:
    """How much the noise that was found enlarges a fitted diameter: the fitted cable, with that noise put on it anew.

    The formula of `beam_bias` is of second order in the noise. This holds all orders, and what short arcs and free axes
    make of them. Noise lies along the beams where their directions are known, else alike in both directions across the
    cable. The draws are used twice, with either sign, so that what is of first order cancels.

    Args:
        fit: The fit of axis and radius.
        sweep: Sweep of each point `[n]`, None if unknown.
        refit: Fits points `[m, 3]` that stand for rows `[m]` of those that were fitted.
        rng: Source of the noise.
    """
    used = np.flatnonzero(fit.weight > 0)
    rows = used[:: max(1, len(used) // RESCANNED)]
    angle = np.arctan2(fit.place.v, fit.place.u)
    turned = incidence(angle, sweep)
    noise = fit.noise_mm * rng.normal(size=(2, len(rows)))
    if turned is not None:  # the scatter off the surface is the noise times the cosine
        slant = np.clip(turned[rows], -LARGEST, LARGEST)
        noise = np.stack([noise[0], -np.tan(slant) * noise[0]])
    change = []
    for sign in (1.0, -1.0):
        out, aside = fit.radius_mm + sign * noise[0], sign * noise[1]
        c, s = np.cos(angle[rows]), np.sin(angle[rows])
        xyz = point_at(fit.axis, Place(fit.place.s[rows], out * c - aside * s, out * s + aside * c))
        change.append(refit(xyz, rows).radius_mm - fit.radius_mm)
    return 2 * float(np.mean(change))


def known_beam_bias(
    fit: CableFit,
    sweep: Int[np.ndarray, " n"] | None,
    instrument: Instrument,
    refit: Callable[[Float[np.ndarray, "n 3"], Int[np.ndarray, " n"]], CableFit],
    rng: np.random.Generator,
) -> BeamBias | None:
    """How much a known scanner has enlarged the fitted diameter: the fitted cable is scanned anew, and fitted as before.

    Each point's beam passes the axis as far aside as the point lies; it meets the fitted surface with its jitter, its range
    is the mean over its footprint, each part weighing as a matte surface sends light back, and noise is added. The same
    draws are used twice, with either sign, so that what is of first order in the noise cancels. Where the scan scatters
    less than the scanner's numbers tell, as behind a filter, the noise is made as much smaller.

    Args:
        fit: The fit of axis and radius.
        sweep: Sweep of each point `[n]`, None if unknown.
        instrument: What is known of the scanner.
        refit: Fits points `[m, 3]` that stand for rows `[m]` of those that were fitted.
        rng: Source of the noise.

    Returns:
        The bias, None where the directions of the beams are not known.
    """
    turned = incidence(np.arctan2(fit.place.v, fit.place.u), sweep)
    if turned is None:
        return None
    radius = fit.radius_mm
    aside = np.hypot(fit.place.u, fit.place.v) * np.sin(turned)
    rows = np.flatnonzero((np.cos(turned) > 0) & (np.abs(aside) < radius))  # the rest lies where no beam comes
    excess = fit.noise_mm / max(_expected(instrument, turned, fit.weight), 1e-12)
    less = min(excess, 1.0)
    change = []
    noise, jitter = less * rng.normal(size=(2, len(rows)))
    for sign in (1.0, -1.0):
        depth = _scanned(aside[rows], instrument, radius, sign * noise, sign * jitter)
        change.append(refit(placed(fit, rows, turned[rows], aside[rows], depth), rows).radius_mm - radius)
    bias = 2 * float(np.mean(change))
    how = f"{100 * KNOWN_DOUBT:.0f} % of the {bias:.2g} mm taken off, from scanning the fitted cable with the scanner's numbers"
    return BeamBias(bias, KNOWN_DOUBT * abs(bias), how, excess)


def _expected(instrument: Instrument, turned: np.ndarray, weight: np.ndarray) -> float:
    """Scatter off the surface that the scanner's noise gives the points that count."""
    c, s = np.cos(np.clip(turned, -LARGEST, LARGEST)), np.sin(turned)
    square = (
        instrument.range_std_mm**2 * c ** (2 - 2 * instrument.incidence_power) + (instrument.lateral_std_mm * s) ** 2
    )
    return float(np.sqrt(np.average(square, weights=weight)))


def _scanned(
    aside: np.ndarray, instrument: Instrument, radius: float, noise: np.ndarray, jitter: np.ndarray
) -> Float[np.ndarray, " n"]:
    """How far before the axis a scanner finds the surface of a cylinder `[n]`, on beams that pass it `aside`."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(NODES)
    met = aside + instrument.lateral_std_mm * jitter
    height = np.sqrt(np.maximum(radius**2 - (met[:, None] + instrument.footprint_mm * nodes) ** 2, 1e-6 * radius**2))
    depth = (height**2 @ weights) / (height @ weights)  # height over radius is the cosine, and the light sent back
    cosine = np.sqrt(np.maximum(1 - (met / radius) ** 2, 0.01))
    return depth - instrument.range_std_mm * cosine**-instrument.incidence_power * noise


def placed(
    fit: CableFit, rows: np.ndarray, turned: np.ndarray, aside: np.ndarray, depth: np.ndarray
) -> Float[np.ndarray, "m 3"]:
    """Points in space `[m, 3]` that lie `aside` of the axis and `depth` before it, as the scanner of each row sees it."""
    toward = np.arctan2(fit.place.v[rows], fit.place.u[rows]) - turned
    u = depth * np.cos(toward) - aside * np.sin(toward)
    v = depth * np.sin(toward) + aside * np.cos(toward)
    return point_at(fit.axis, Place(fit.place.s[rows], u, v))
