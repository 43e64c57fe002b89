"""Noise along the beam: it moves a point around the circle as well as off it, and so moves the fitted radius.

A range error e on a beam that meets the surface at incidence i leaves e cos(i) off the surface and e sin(i) along it. A
point moved along the surface by t lies t^2 / 2R outside; and since the points thin out with cos(i), those that noise has
brought to a place come more from the denser side, and lie outside for that as well.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from cablejax.measure.fit import CableFit

BIN_DEG = 5.0
LARGEST = np.radians(72.0)  # incidence; beyond, points are left out or too few to matter
BEAM_DOUBT = 0.3  # of the correction: jitter across the beam adds less, and noise need not grow as assumed
KNOWN_DOUBT = 0.1  # of the correction with a scanner's own numbers
WIDTH_DOUBT = 0.5  # of the correction: what a scanner makes of a wide echo is its maker's secret
FOOTPRINTS = 2.0  # standard deviations of the beam that must lie on the cable, for a point to count


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

    def grazing(self, radius_mm: float) -> float:
        """Cosine of the incidence below which the beam passes the silhouette within `FOOTPRINTS` of its width."""
        sine = max(1 - FOOTPRINTS * self.footprint_mm / radius_mm, 0.0)
        return float(np.sqrt(1 - sine**2))


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


class BeamBias(NamedTuple):
    """What the beams have done to a fitted diameter, in mm.

    Attributes:
        noise_mm: What noise of the ranges and of the beams' directions has added.
        noise_doubt_mm: Its standard deviation.
        width_mm: What the beams' width has added, mostly below 0; 0 where the scanner is not known.
        width_doubt_mm: Its standard deviation.
        excess: Scatter that was found over the one that the scanner's numbers give; NaN where it is not known.
    """

    noise_mm: float
    noise_doubt_mm: float
    width_mm: float
    width_doubt_mm: float
    excess: float

    @property
    def total_mm(self) -> float:
        return self.noise_mm + self.width_mm


def beam_bias(fit: CableFit, sweep: Int[np.ndarray, " n"] | None, instrument: Instrument | None = None) -> BeamBias:
    """How much noise along the beams, and with a known scanner their width, has enlarged the fitted diameter.

    At incidence i, with c and s its cosine and sine, noise of variance v c^-2p along the beam and j^2 across it leaves
    the points that are found there outside the surface by, on average,

        (v (c^(2-2p) - (2 - 2p) s^2 c^-2p + s^2 c^-2p / 2) + j^2 (5 s^2 - 1) / 2) / R,

    and a beam that reports the mean range over a Gaussian footprint of standard deviation f leaves them inside by
    f^2 / (2 R c^2). Each counts by its weight in the radius. Of an unknown scanner p = 1 and j = 0 are taken, and v is the
    variance of the residuals; of a known one the variance given, or less where less is found, as behind a filter. Where
    the directions of the beams are not known, points that thin out with c stand for them; of an unknown scanner i = 0.

    Args:
        fit: The fit of axis and radius.
        sweep: Sweep of each point `[n]`, None if unknown.
        instrument: What is known of the scanner.
    """
    turned = incidence(np.arctan2(fit.place.v, fit.place.u), sweep)
    known = instrument is not None
    if turned is not None:
        angle, lever = np.clip(turned, -LARGEST, LARGEST), fit.lever
    else:
        angle = np.linspace(-LARGEST, LARGEST, 181) if known else np.zeros(1)
        lever = np.cos(angle) / np.cos(angle).sum() * fit.lever.sum()
    c, s = np.cos(angle), np.sin(angle)
    p = instrument.incidence_power if known else 1.0
    along = c ** (2 - 2 * p) - (2 - 2 * p) * s**2 * c ** (-2 * p) + 0.5 * s**2 * c ** (-2 * p)
    if instrument is None:
        noise = 2 * fit.noise_mm**2 / fit.radius_mm * float(np.sum(lever * along))
        return BeamBias(noise, BEAM_DOUBT * abs(noise), 0.0, 0.0, float("nan"))
    v, j, f = instrument.range_std_mm**2, instrument.lateral_std_mm, instrument.footprint_mm
    share = np.abs(lever) / np.abs(lever).sum()
    expected = float(np.sum(share * (v * c ** (2 - 2 * p) + j**2 * s**2)))
    excess = fit.noise_mm / np.sqrt(expected) if expected > 0 else float("inf")
    moved = float(np.sum(lever * (v * along + j**2 * (2.5 * s**2 - 0.5))))
    noise = 2 / fit.radius_mm * min(excess**2, 1.0) * moved
    width = -float(np.sum(lever * f**2 / c**2)) / fit.radius_mm
    return BeamBias(noise, KNOWN_DOUBT * abs(noise), width, WIDTH_DOUBT * abs(width), excess)
