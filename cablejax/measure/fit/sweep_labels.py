"""Sweeps of the scanner, told from the order of the rows: a file in scan order runs along the cable again and again.

Each sweep carries a shift of its own after registration, which does not average out. Where the rows are in scan order the
sweeps show as runs along the axis, and each can be given its shift in the fit as if its station had been named.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from cablejax.measure.fit.axis import Place

CHUNK = 48  # rows that are looked at together
LEAST_ROWS = 150  # in a sweep; shorter runs join the one before
GRAZING = 0.35  # share of a sweep's densest directions below which the beam grazes: the cosine of 70 degrees
BIN_DEG = 2.5
LEAST_DENSE = 16.0  # points in such a bin, below which an edge cannot be seen for chance, and nothing is left out
ONE_VIEW_DEG = 200.0  # more than this comes of several views, and is thin where views are few, not where beams graze
MARGIN = 2.0  # standard deviations of the noise, left out at the edges of what was seen


def sweeps_of(along_mm: Float[np.ndarray, " n"]) -> Int[np.ndarray, " n"] | None:
    """The sweep of each row `[n]`, or None where the rows are in no order along the cable, or in a single sweep.

    Medians of chunks of rows move along the axis step by step; where they jump back by more than a tenth of the length,
    or turn round for good, another sweep begins.

    Args:
        along_mm: Arc length of the points, in the order of the file.

    Example:
        >>> twice = np.concatenate([np.linspace(0, 100, 2000)] * 2)
        >>> np.flatnonzero(np.diff(sweeps_of(twice))).tolist()
        [1999]
    """
    n = len(along_mm)
    count = n // CHUNK
    length = float(np.ptp(along_mm)) if n else 0.0
    if count < 2 * LEAST_ROWS // CHUNK or length == 0:
        return None
    chunks = along_mm[: count * CHUNK].reshape(count, CHUNK)
    low, middle, high = np.quantile(chunks, [0.25, 0.5, 0.75], axis=1)
    if np.median(high - low) > 0.05 * length:
        return None
    cuts = _jumps(along_mm, middle, length)
    starts: list[int] = []
    for cut in cuts:
        if cut - (starts[-1] if starts else 0) >= LEAST_ROWS and n - cut >= LEAST_ROWS:
            starts.append(int(cut))
    if not starts:
        return None
    return np.searchsorted(np.array(starts), np.arange(n), side="right")


def _jumps(along: np.ndarray, middle: np.ndarray, length: float) -> list[int]:
    """Rows at which a run along the axis ends: at a jump of the chunks' medians, placed to the row, or at a turn."""
    step = np.diff(middle)
    cuts = []
    for chunk in np.flatnonzero(np.abs(step) > 0.1 * length):
        first = max(0, (int(chunk) - 1) * CHUNK)
        window = along[first : (chunk + 3) * CHUNK]
        before, after = middle[max(chunk - 1, 0)], middle[min(chunk + 2, len(middle) - 1)]
        if abs(after - before) < 0.1 * length:
            continue  # a chunk in the middle of the jump, or one stray chunk
        nearer = np.abs(window - after) < np.abs(window - before)
        errors = np.concatenate([[0], np.cumsum(nearer)]) + np.concatenate([np.cumsum(~nearer[::-1])[::-1], [0]])
        cuts.append(int(first) + int(np.argmin(errors)))
    cuts += [int(row) * CHUNK for row in _turns(middle, step, length)]
    return sorted(cuts)


def _turns(middle: np.ndarray, step: np.ndarray, length: float) -> list[int]:
    """Chunks at which the way along the axis turns round, by a tenth of the length on either side."""
    turns, extreme, heading = [], 0, 0.0
    for chunk in range(1, len(middle)):
        if abs(step[chunk - 1]) > 0.1 * length:  # a jump: a new run, whose heading is not known yet
            extreme, heading = chunk, 0.0
            continue
        gone = middle[chunk] - middle[extreme]
        if heading == 0.0:
            heading = float(np.sign(gone)) if abs(gone) > 0.1 * length else 0.0
        elif heading * gone > 0:
            extreme = chunk
        elif abs(gone) > 0.1 * length:
            turns.append(extreme)
            heading = -heading
            extreme = chunk
    return turns


def at_the_edge(
    place: Place, sweep: Int[np.ndarray, " n"] | None, *, noise_mm: float, radius_mm: float
) -> Bool[np.ndarray, " n"]:
    """Which points `[n]` lie at the edges of what a sweep saw around the circumference, or were seen at a grazing angle.

    Beams lie evenly across the view, so the points on the surface thin out with the cosine of the incidence. Grazing
    ranges are averaged over the silhouette and what lies behind it, and points land outside the surface. And noise along
    the beam moves a point off the surface and around it at once: those that noise has carried over an edge all lie on one
    side of the surface, which makes a short arc too small. So a margin of the noise is left out at every edge.

    Args:
        place: Cable coordinates.
        sweep: Sweep of each point, or None for one.
        noise_mm: Standard deviation of the points about the surface.
        radius_mm: Radius of the cable.
    """
    width = int(360 / BIN_DEG)
    bins = (np.degrees(np.arctan2(place.v, place.u)) % 360 / BIN_DEG).astype(int)
    if sweep is None:
        pooled = np.bincount(np.minimum(bins, width - 1), minlength=width)
        if BIN_DEG * (pooled > 0.1 * np.sort(pooled)[-8:].mean()).sum() > ONE_VIEW_DEG:
            return np.zeros(len(place.s), dtype=bool)
        sweep = np.zeros(len(place.s), dtype=int)
    key = sweep * width + np.minimum(bins, width - 1)
    density = np.bincount(key, minlength=(int(sweep.max()) + 1) * width).reshape(-1, width)
    densest = np.sort(density, axis=1)[:, -8:].mean(axis=1, keepdims=True)
    seen = density >= GRAZING * densest
    seen = np.array([_without_holes(row) for row in seen])
    inner = seen.copy()
    for shift in range(1, 1 + max(1, round(np.degrees(MARGIN * noise_mm / radius_mm) / BIN_DEG))):
        inner &= np.roll(seen, shift, axis=1) & np.roll(seen, -shift, axis=1)
    inner |= densest < LEAST_DENSE
    return ~inner.reshape(-1)[key]


def _without_holes(seen: Bool[np.ndarray, " bins"]) -> Bool[np.ndarray, " bins"]:
    """The bins around a circle from one edge of what was seen to the other: all but the longest run of unseen ones."""
    if seen.all() or not seen.any():
        return seen
    first = int(np.flatnonzero(seen)[0])
    turned = np.flatnonzero(np.roll(seen, -first))
    gaps = np.diff(np.append(turned, len(seen)))
    widest = int(np.argmax(gaps))
    out = np.ones(len(seen), dtype=bool)
    out[turned[widest] + 1 : turned[widest] + gaps[widest]] = False
    return np.roll(out, first)


def blocks(station: Int[np.ndarray, " n"], along_mm: Float[np.ndarray, " n"], *, pieces: int) -> Int[np.ndarray, " n"]:
    """A number for every station in every one of `pieces` equal stretches of the length, without gaps.

    A station's shift may differ from stretch to stretch: an arm drifts, a window is swept twice.
    """
    low, high = along_mm.min(), along_mm.max()
    piece = np.clip(((along_mm - low) / max(high - low, 1e-9) * pieces).astype(int), 0, pieces - 1)
    return np.unique(station * pieces + piece, return_inverse=True)[1].reshape(-1)
