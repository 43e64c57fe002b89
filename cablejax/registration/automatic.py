"""Registration of two scans of which nothing is known: own scales, several starts compared, and a verdict on the best."""

from contextlib import suppress
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Num

from cablejax.geometry.normals import nearest, plain_tree, surface_normals
from cablejax.geometry.voxels import voxel_means
from cablejax.registration.coarse import coarse_start
from cablejax.registration.gauss_newton import Kernel, Method
from cablejax.registration.icp import check_points, host_points
from cablejax.registration.pyramid import register
from cablejax.registration.result import RegistrationResult

COARSE, FINE = 1_500, 24_000  # voxels that hold points at the coarsest and, at most, at the finest level
NEAR = 1.5  # finest voxels within which a point lies on the other scan
ALIKE_COS = 0.8  # of the angle between normals of the same surface
LEAST_OVERLAP = 0.1  # of either scan, below which the motion is a guess
DOUBTFUL_OVERLAP = 0.3  # below which other motions may explain as much
RIVAL = 0.9  # of the best start's overlap, from which on another motion is as good
APART = 4.0  # finest voxels by which two motions differ at the scan's size
LOOSE = 1.5  # finest voxels: a larger root mean square distance is more than the grid and the noise leave


class Alignment(NamedTuple):
    """The best motion of several starts.

    Attributes:
        result: The registration, at the finest level.
        voxels: Sides of the voxels, coarse to fine, in the clouds' unit.
        start: Where the best one began: "given", "centres" or "features".
        overlap: Share of the source that lies on the target with normals alike, within `NEAR` finest voxels.
        rival: The same of the best other motion; None where all starts came to the same.
        doubts: What speaks against the result, in words; empty where nothing does.
    """

    result: RegistrationResult
    voxels: tuple[float, ...]
    start: str
    overlap: float
    rival: float | None
    doubts: tuple[str, ...]


def register_auto(
    source: Num[np.ndarray, "n 3"],
    target: Num[np.ndarray, "m 3"],
    *,
    method: Method = "gicp",
    kernel: Kernel = "none",
    seed: int = 0,
) -> Alignment:
    """Find the motion that takes a source scan onto a target scan, and say how far it can be trusted.

    The voxels' sides come from the number of points that they leave. Registration begins at the poses as given, with the
    centres brought together, and at what matched features tell; each end is scored by the share of the source that then
    lies on the target with normals alike, and the best is kept.

    Args:
        source: Points `[n, 3]`.
        target: Points `[m, 3]`, in the same unit.
        method, kernel: As in `icp`.
        seed: Of the triples of features drawn.

    Raises:
        ValueError: If a scan has fewer than six points, or no start brings a tenth of either onto the other.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> box = rng.uniform(size=(4000, 3)); box[np.arange(4000), np.arange(4000) % 3] = 0
        >>> found = register_auto(box + [0.4, 0.0, -0.2], box)
        >>> np.abs(found.result.T_target_source[:3, 3] - [-0.4, 0.0, 0.2]).max() < 5e-3, found.doubts
        (np.True_, ())
    """
    moving, fixed = host_points(source, "source"), host_points(target, "target")
    check_points(moving, fixed)
    voxels = scales_of(fixed)
    compared = _Compared(moving, fixed, voxels[-1])
    ends = []
    for name, T in _starts(moving, fixed, voxels[0], seed).items():
        found = register(moving, fixed, voxels=voxels, T_init=T, method=method, kernel=kernel)
        ends.append((compared.overlap(found.T_target_source), name, found))
    ends.sort(key=lambda end: -end[0])
    best, start, found = ends[0]
    others = [share for share, _, end in ends[1:] if compared.apart(end.T_target_source, found.T_target_source)]
    if best < LEAST_OVERLAP:
        raise ValueError(
            f"source, target: of {len(ends)} starts the best brings {100 * best:.0f} % of the source onto the target, where at "
            f"least {100 * LEAST_OVERLAP:.0f} % are needed; the scans share too little, or are in different units"
        )
    rival = max(others, default=None)
    return Alignment(
        result=found,
        voxels=voxels,
        start=start,
        overlap=best,
        rival=rival,
        doubts=_doubts(found, best, rival, voxels[-1]),
    )


def scales_of(xyz: Float[np.ndarray, "n 3"]) -> tuple[float, ...]:
    """Sides of voxels, each half of the one before: from some `COARSE` that hold points to `FINE`, or to the scan's spacing."""
    size = float(np.ptp(xyz, axis=0).max()) or 1.0
    side = size / 20
    for _ in range(30):
        count = len(voxel_means(xyz, side))
        if count >= min(COARSE, 0.5 * len(xyz)):
            break
        side /= 2**0.5
    sides = [side]
    while len(sides) < 4 and len(voxel_means(xyz, sides[-1] / 2)) < min(FINE, 0.7 * len(xyz)):
        sides.append(sides[-1] / 2)
    return tuple(sides)


def _starts(moving: np.ndarray, fixed: np.ndarray, voxel: float, seed: int) -> dict[str, Float[np.ndarray, "4 4"]]:
    """Motions to begin with, by name."""
    centres = np.eye(4)
    centres[:3, 3] = voxel_means(fixed, voxel).mean(axis=0) - voxel_means(moving, voxel).mean(axis=0)
    starts = {"given": np.eye(4), "centres": centres}
    with suppress(ValueError):  # too few voxels, or no three matches agree: the other starts are left
        starts["features"] = coarse_start(moving, fixed, voxel=voxel, seed=seed).T_target_source
    return starts


class _Compared:
    """Two scans, thinned, on which motions are scored."""

    def __init__(self, moving: np.ndarray, fixed: np.ndarray, voxel: float) -> None:
        self.voxel = voxel
        self.moving, self.fixed = voxel_means(moving, voxel), voxel_means(fixed, voxel)
        self.tree = plain_tree(self.fixed)
        self.own, self.there = surface_normals(self.moving, k=20), surface_normals(self.fixed, k=20, tree=self.tree)

    def overlap(self, T: Float[np.ndarray, "4 4"]) -> float:
        """Share of the source on the target with normals alike."""
        xyz, normals = self.moving @ T[:3, :3].T + T[:3, 3], self.own @ T[:3, :3].T
        distance, near = (found[:, 0] for found in nearest(self.tree, xyz, k=1, max_distance=NEAR * self.voxel))
        there = self.there[np.minimum(near, len(self.fixed) - 1)]
        return float((np.isfinite(distance) & (np.abs(np.sum(there * normals, axis=1)) > ALIKE_COS)).mean())

    def apart(self, first: Float[np.ndarray, "4 4"], second: Float[np.ndarray, "4 4"]) -> bool:
        """Whether two motions bring the source to places that differ."""
        change = first - second
        moved = self.moving @ change[:3, :3].T + change[:3, 3]
        return bool(np.sqrt(np.mean(np.sum(moved**2, axis=1))) > APART * self.voxel)


def _doubts(found: RegistrationResult, overlap: float, rival: float | None, voxel: float) -> tuple[str, ...]:
    """Sentences about overlap, residual and conditioning."""
    out = []
    if overlap < DOUBTFUL_OVERLAP:
        out.append(f"only {100 * overlap:.0f} % of the source lie on the target: another motion may explain as much")
    if rival is not None and rival > RIVAL * overlap:
        out.append(
            f"another motion brings {100 * rival:.0f} % of the source onto the target, this one {100 * overlap:.0f} %"
        )
    if found.rmse > LOOSE * voxel:
        out.append(f"points lie {found.rmse:.3g} from the target (root mean square), much for voxels of {voxel:.3g}")
    if not found.converged:
        out.append("the last step still moved the points")
    if not found.seen.all():
        out.append(f"{int((~found.seen).sum())} of 6 directions of motion are not seen, and stay as the start has them")
    return tuple(out)
