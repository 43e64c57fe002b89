"""The diameter along the axis wherever something round is about it: joints, tapers and steps, which one radius does not fit."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from cablejax.geometry.robust import robust_std
from cablejax.measure.fit.axis import Axis, Place, locate, trimmed
from cablejax.measure.fit.least_squares import tukey
from cablejax.measure.shape.sections import BIN_DEG, bins_of

WIDEST = 3.0  # times the fitted radius, within which a section is looked for
LEAST_RADIUS = 0.3  # likewise
RINGS = 120  # radii that are tried, on a log scale
RING = 0.04  # of the radius, or two standard deviations of the noise: half the width of a ring
LEAST_ARC_DEG = 40.0
LEAST_SHARE_OF_ARC = 0.6  # of the usual arc, that a section must show to be the thing's
MIN_POINTS = 20
BEYOND = 8.0  # radii beyond the ends that are looked at
KNOWN = 0.01  # of the diameter: what is worse known beyond the ends is something else
CENTER_STD = 0.2  # of the radius: how far a section's centre may lie from the axis
TURNS = 8
END, UNLIKE = 3, 0.05  # slabs at an end that may hold its face, and the share by which their diameters then differ


class Profile(NamedTuple):
    """Circles in slabs along the axis, each of whatever radius its points have.

    Attributes:
        s_mm: Mean place of each slab's points along the axis `[m]`, those without a circle left out.
        diameter_mm: Its diameter `[m]`.
        std_mm: Standard deviation from noise, arc and number of points `[m]`.
        center_mm: Where its centre lies off the axis, in the axis's frame `[m, 2]`: an axis that was fitted with one radius
            to a thing of several leans.
        step_mm: Distance between slabs.
    """

    s_mm: Float[np.ndarray, " m"]
    diameter_mm: Float[np.ndarray, " m"]
    std_mm: Float[np.ndarray, " m"]
    center_mm: Float[np.ndarray, "m 2"]
    step_mm: float

    def subset(self, rows: np.ndarray | slice) -> "Profile":
        """Some of the slabs."""
        return Profile(self.s_mm[rows], self.diameter_mm[rows], self.std_mm[rows], self.center_mm[rows], self.step_mm)

    def distance(self, place: Place) -> Float[np.ndarray, " n"]:
        """Distance of points from the line through the circles' centres `[n]`."""
        u, v = (np.interp(place.s, self.s_mm, center) for center in self.center_mm.T)
        return np.hypot(place.u - u, place.v - v)


def profile_along(
    xyz: Float[np.ndarray, "n 3"], axis: Axis, *, radius_mm: float, noise_mm: float, step_mm: float
) -> Profile:
    """Fit a circle to every slab of the points about an axis, and about its straight continuation at both ends.

    What a fit of one radius leaves out, the cable before and behind a joint or the joint itself, lies there: sections
    beyond the ends are kept as far as they follow without a gap of a diameter and are known to a hundredth.

    In each slab the radius is sought whose ring, as wide as the noise, shows most of the circumference: what lies beside
    or behind is at another distance in every direction. About it a circle is fitted by reweighted least squares, its
    centre held near the axis. Slabs that show much less than is usual are left out.

    Args:
        xyz: The scan's points `[n, 3]`, mm.
        axis: The thing's axis.
        radius_mm: Its radius somewhere.
        noise_mm: Standard deviation of its points about it.
        step_mm: Length of a slab.
    """
    beyond = BEYOND * radius_mm
    length = axis.s[-1]
    axis = trimmed(axis, -beyond, length + beyond)
    box = WIDEST * radius_mm
    near = (xyz > axis.xyz.min(axis=0) - box).all(axis=1) & (xyz < axis.xyz.max(axis=0) + box).all(axis=1)
    place = locate(axis, xyz[near])
    distance = np.hypot(place.u, place.v)
    keep = (place.s >= 0) & (place.s <= axis.s[-1]) & (distance < WIDEST * radius_mm)
    place, distance = Place(*(part[keep] for part in place)), distance[keep]
    count = max(1, int(axis.s[-1] / step_mm))
    slab = np.minimum((place.s / axis.s[-1] * count).astype(int), count - 1)
    order = np.argsort(slab, kind="stable")
    first = np.searchsorted(slab[order], np.arange(count + 1))
    found = []
    for number in range(count):
        rows = order[first[number] : first[number + 1]]
        circle = _circle(place.u[rows], place.v[rows], radius_mm, noise_mm)
        if circle is not None:
            found.append((float(place.s[rows].mean()), *circle))
    s, diameter, std, arc, u, v = np.array(found).reshape(-1, 6).T
    whole = Profile(s - beyond, diameter, std, np.stack([u, v], axis=1), axis.s[-1] / count)
    inside = (whole.s_mm >= 0) & (whole.s_mm <= length)
    if not inside.any():
        return whole.subset(inside)
    known = inside | ((std < KNOWN * diameter) & (np.hypot(u, v) < CENTER_STD * radius_mm))
    whole = whole.subset(known & (arc >= LEAST_SHARE_OF_ARC * np.median(arc[inside])))
    return _without_ends(_connected(whole, length, gap=2 * radius_mm))


def _connected(profile: Profile, length: float, *, gap: float) -> Profile:
    """The slabs on the axis, and those beyond its ends up to the first gap."""
    s = profile.s_mm
    inside = np.flatnonzero((s >= 0) & (s <= length))
    if len(inside) == 0:
        return profile
    wide = np.flatnonzero(np.diff(s) > gap)
    first = int(max([row + 1 for row in wide if row < inside[0]], default=0))
    last = int(min([row for row in wide if row >= inside[-1]], default=len(s) - 1))
    return profile.subset(slice(first, last + 1))


def _without_ends(profile: Profile) -> Profile:
    """At either end at most `END` slabs fewer, those that lie off their neighbours: they hold an end face or its rim."""
    d = profile.diameter_mm
    if len(d) < 4 * END:
        return profile
    low, high = _odd(d), len(d) - _odd(d[::-1])
    return profile.subset(slice(low, high))


def _odd(diameter: Float[np.ndarray, " m"]) -> int:
    """How many of the first diameters are unlike those that follow."""
    for skip in range(END, 0, -1):
        behind = diameter[skip : skip + END]
        if len(behind) == END and abs(diameter[skip - 1] / np.median(behind) - 1) > UNLIKE:
            return skip
    return 0


def _circle(u: np.ndarray, v: np.ndarray, radius: float, noise: float) -> tuple[float, ...] | None:
    """Diameter, its standard deviation, the arc in degrees and the centre; None where there is no circle."""
    if len(u) < MIN_POINTS:
        return None
    start = _ring(np.hypot(u, v), bins_of(np.arctan2(v, u)), radius, noise)
    state, scale, width = np.array([0.0, 0.0, start]), noise, 0.25 * start
    weight, normal = np.ones_like(u), np.eye(3)
    prior = np.array([1.0, 1.0, 0.0]) / (CENTER_STD * radius) ** 2
    for _ in range(TURNS):
        du, dv = u - state[0], v - state[1]
        distance = np.maximum(np.hypot(du, dv), 1e-9)
        residual = distance - state[2]
        inside = np.abs(residual) < width
        if inside.sum() < MIN_POINTS:
            return None
        scale = max(robust_std(residual[inside]), 1e-6 * radius)
        weight = np.where(inside, tukey(residual, scale), 0.0)
        columns = np.stack([du / distance, dv / distance, np.ones_like(u)])
        normal = (columns * weight) @ columns.T + scale**2 * np.diag(prior)
        state = state + np.linalg.solve(normal, columns @ (weight * residual) - scale**2 * prior * state)
        width = max(4.0 * scale, RING * radius)
    on = weight > 0
    arc = BIN_DEG * len(np.unique(bins_of(np.arctan2(v - state[1], u - state[0])[on])))
    good = LEAST_RADIUS * radius < state[2] < WIDEST * radius and arc >= LEAST_ARC_DEG
    if not good:
        return None
    return 2 * float(state[2]), 2 * scale * float(np.sqrt(np.linalg.inv(normal)[2, 2])), arc, *map(float, state[:2])


def _ring(distance: np.ndarray, bins: np.ndarray, radius: float, noise: float) -> float:
    """The radius whose ring shows most of the circumference; of those alike the one with most points."""
    radii = radius * np.geomspace(LEAST_RADIUS, WIDEST, RINGS)
    half = np.maximum(RING * radii, 2 * noise)
    inside = np.abs(distance[None, :] - radii[:, None]) < half[:, None]
    around = np.zeros((RINGS, int(360 / BIN_DEG)), dtype=bool)
    ring, point = np.nonzero(inside)
    around[ring, bins[point]] = True
    best = int(np.argmax(around.sum(axis=1) + inside.sum(axis=1) / (len(distance) + 1.0)))
    return float(np.median(distance[inside[best]])) if inside[best].any() else radius
