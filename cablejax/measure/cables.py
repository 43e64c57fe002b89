"""Every cable of a scene: found, measured and taken out in turn, until nothing round is left."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Num

from cablejax.geometry.principal import facing_up, principal_axes
from cablejax.measure import agree
from cablejax.measure.accept import accepted
from cablejax.measure.agree import CLEAR
from cablejax.measure.assemble import assembled
from cablejax.measure.errors import MeasureError, NoCableError
from cablejax.measure.find.cables import Find, alike, find_cables, several
from cablejax.measure.find.track import Track
from cablejax.measure.fit.axis import Axis, Place, locate, sampled
from cablejax.measure.messages import about_number, found_once, nothing_found
from cablejax.measure.result import CableMeasurement, CableScene, NotMeasured
from cablejax.measure.scan import Scan, scan_of
from cablejax.measure.settings import MeasureSettings, SearchLimits

if TYPE_CHECKING:
    from cablejax.types import PointCloud

ROUNDS = 8  # of search, each in what the ones before have left
BELONGS, BELONGS_SIGMA = (
    0.08,
    4.5,
)  # radii or standard deviations beyond the surface within which a point is the cable's
WITHIN = 0.5  # of a track's points, on cables measured before, above which it is one of them
THROUGH = 0.8  # of the sum of two radii, below which two axes have come too near: cables do not go through each other
PIECE = 1.0  # diameters: shorter round things are none of the scene's cables
ROUGH = 2.0  # times the surface's roughness, by which a smooth track scatters
ROUGH_NOISE = 0.1  # of the radius
LEAST_MERIT = 0.02  # of the best track's of all rounds: lesser ones are specks that no one asks about


def measure_cables(
    cloud_or_xyz_mm: "PointCloud | Num[np.ndarray, 'n 3']",
    *,
    station: Int[np.ndarray, " n"] | None = None,
    on_cable: Bool[np.ndarray, " n"] | None = None,
    catalogue: Mapping[str, float] | None = None,
    settings: MeasureSettings | None = None,
    expect: int | None = None,
) -> CableScene:
    """Find every cable in a scan and measure each as `measure_cable` does.

    The tracks of a search are measured from the best on; what belongs to a measured cable is taken out, and what is left is
    searched again, until a search finds no further cable. A track that runs through a measured cable is none.

    Args:
        cloud_or_xyz_mm: The scan `[n, 3]` in millimetres, or a padded cloud.
        station, on_cable, catalogue, settings: As in `measure_cable`.
        expect: How many cables there should be: a warning says so where another number is found.

    Returns:
        The cables, numbered from 1 along the direction in which they lie side by side, or by their distance from
        `settings.limits.near_mm`; and what looked like one and could not be measured, with the reason.

    Raises:
        MeasureError: If no cable could be measured.
        ValueError: As in `measure_cable`, or if `expect` is below 1.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> angle, along = rng.uniform(0, np.pi, (2, 4000)), rng.uniform(0, 200, (2, 4000))
        >>> xyz = np.stack([along, 10 * np.cos(angle), 10 * np.sin(angle)], axis=-1) + [[[0, 0, 0]], [[0, 40, 0]]]
        >>> scene = measure_cables((xyz + 0.05 * rng.normal(size=xyz.shape)).reshape(-1, 3), expect=2)
        >>> [round(one.diameter_mm) for one in scene.cables], scene.warnings
        ([20, 20], ())
    """
    settings = settings if settings is not None else MeasureSettings()
    if expect is not None and expect < 1:
        raise ValueError(f"expect: expected at least 1, got {expect}")
    scan = scan_of(cloud_or_xyz_mm, station=station, on_cable=on_cable, limits=settings.limits)
    settings = scan.views(settings)
    found, failed = _every(scan, catalogue, settings)
    if not found:
        raise failed[0].error
    found = _numbered(found, scan.moved(settings.limits))
    label = np.zeros(scan.count, dtype=np.int32)
    label[scan.rows] = _labels(scan.xyz, found)
    missed = tuple(
        NotMeasured(2 * track.radius_mm, track.length_mm, track.axis + scan.origin, str(error))
        for track, error in failed
        if track is not None and not isinstance(error, NoCableError) and not _in_any(track, found)
    )
    return CableScene(tuple(one.result for one in found), label, missed, about_number(len(found), len(missed), expect))


class _Measured(NamedTuple):
    """A cable that was measured: its result, the scan's rows on it and in it, its axis near the origin, and its radius."""

    result: CableMeasurement
    rows: Int[np.ndarray, " k"]
    axis: Axis
    radius_mm: float


class _Failed(NamedTuple):
    """A track that could not be measured; None for a scan without any."""

    track: Track | None
    error: MeasureError


def _every(
    scan: Scan, catalogue: Mapping[str, float] | None, settings: MeasureSettings
) -> tuple[list[_Measured], list[_Failed]]:
    """All cables, and what could not be measured in the last round, the best first."""
    found: list[_Measured] = []
    failed: list[_Failed] = []
    rng = np.random.default_rng(settings.seed)
    best = 0.0
    for turn in range(ROUNDS):
        find = find_cables(scan.xyz, rng=rng, every=True, limits=scan.moved(settings.limits))
        others = _Others(scan, settings, turn)
        before, best = len(found), max([best, *(track.merit for track in find.tracks)])
        failed = [] if find.tracks else [_Failed(None, nothing_found(find))]
        for track in _worth(find, LEAST_MERIT * best):
            if _taken(find, track, found[before:]):
                continue
            try:
                one = _one(scan, track, find, found, catalogue, settings)
                others.confirm(one)
            except MeasureError as error:
                failed.append(_Failed(track, error))
                continue
            found.append(one)
            scan = scan.subset(~np.isin(scan.rows, one.rows))
        if len(found) == before or len(scan.xyz) < 50:
            break
    return found, failed


class _Others:
    """Further searches of what a round began with, made when they are first asked for: a cable must be found by one of two."""

    def __init__(self, scan: Scan, settings: MeasureSettings, turn: int) -> None:
        self.scan, self.settings, self.turn = scan, settings, turn
        self.finds: list[Find] = []

    def confirm(self, one: _Measured) -> None:
        """Refuse what neither finds, unless it holds most of the points.

        Raises:
            NoCableError: If so.
        """
        if one.result.noise_mm > ROUGH_NOISE * one.radius_mm:  # a rough tube holds half of any cloud
            self._measured_again(one)
            return
        if one.result.keep.sum() > CLEAR * len(self.scan.xyz):
            return
        for number in range(2):
            if number == len(self.finds):
                rng = np.random.default_rng((self.settings.seed, self.turn, number))
                limits = self.scan.moved(self.settings.limits)
                self.finds.append(find_cables(self.scan.xyz, rng=rng, every=True, limits=limits))
            if any(_is(self.finds[number], track, one) for track in self.finds[number].tracks):
                return
        raise found_once(one.result.diameter_mm)

    def _measured_again(self, one: _Measured) -> None:
        """Refuse what neither of two searches for the best cable measures alike."""
        for number in (1, 2):
            rng = np.random.default_rng(self.settings.seed + number)
            find = find_cables(self.scan.xyz, rng=rng, limits=self.scan.moved(self.settings.limits))
            for track in (track for track in find.tracks if _is(find, track, one)):
                try:
                    again = _one(self.scan, track, find, [], None, self.settings)
                except MeasureError:
                    continue
                if agree.alike(again.result, one.result):
                    return
        raise found_once(one.result.diameter_mm)


def _is(find: Find, track: Track, one: _Measured) -> bool:
    """Whether a track is a measured cable: about as thick, and most of its points on it."""
    return alike(track.radius_mm, one.radius_mm) and _taken(find, track, [one])


def _worth(find: Find, least_merit: float) -> list[Track]:
    """The tracks that are worth a fit, the smoothest first: of cables that touch, the best track may run over several."""
    rough = ROUGH * find.surface.roughness_mm
    worth = [track for track in find.tracks if track.merit > least_merit]
    worth = [track for track in worth if not several(track, worth)]
    return sorted(worth, key=lambda track: -track.merit / (1 + (track.scatter_mm / rough) ** 2))


def _one(
    scan: Scan,
    track: Track,
    find: Find,
    found: list[_Measured],
    catalogue: Mapping[str, float] | None,
    settings: MeasureSettings,
) -> _Measured:
    """Measure a track.

    Raises:
        MeasureError: If it is no cable, none of those that are sought, or runs through one that was measured.
    """
    one = accepted(scan, track, find, settings)
    fit = one.fitted.fit
    alone = find._replace(tracks=[track])  # the others are measured in their turn: none is "a second cable"
    result = assembled(one, alone, catalogue, settings)
    axis = sampled(result.axis_mm - scan.origin, step=0.2 * fit.radius_mm)
    if (why := _unwanted(result, axis, found)) is not None:
        raise NoCableError(why)
    place = locate(axis, scan.xyz)
    mine = _belongs(place, axis, fit.radius_mm, fit.noise_mm)
    return _Measured(result, scan.rows[mine], axis, fit.radius_mm)


def _unwanted(result: CableMeasurement, axis: Axis, found: list[_Measured]) -> str | None:
    """Why a measured thing is no cable of the scene; None if it is one."""
    if result.length_mm < PIECE * result.diameter_mm:
        return f"It is a piece of {result.length_mm:.3g} mm, shorter than its diameter of {result.diameter_mm:.3g} mm."
    if any(_through(axis.xyz, 0.5 * result.diameter_mm, other) for other in found):
        return "It runs through a cable that was measured."
    return None


def _belongs(place: Place, axis: Axis, radius: float, noise: float) -> Bool[np.ndarray, " n"]:
    """Which points lie on or in a cable."""
    near = np.hypot(place.u, place.v) < radius + _fringe(radius, noise)
    return near & (place.s > -radius) & (place.s < axis.s[-1] + radius)


def _fringe(radius: float, noise: float) -> float:
    """How far from the surface a point may lie that belongs to it."""
    return max(BELONGS * radius, BELONGS_SIGMA * noise)


def _labels(xyz: Float[np.ndarray, "m 3"], found: list[_Measured]) -> Int[np.ndarray, " m"]:
    """The number of the cable whose surface is nearest to each point, 0 beyond the fringe of all."""
    label, nearest = np.zeros(len(xyz), dtype=np.int32), np.full(len(xyz), np.inf)
    for number, one in enumerate(found, 1):
        place = locate(one.axis, xyz)
        apart = np.abs(np.hypot(place.u, place.v) - one.radius_mm)
        within = (place.s > 0) & (place.s < one.axis.s[-1])
        mine = within & (apart < np.minimum(_fringe(one.radius_mm, one.result.noise_mm), nearest))
        label[mine], nearest[mine] = number, apart[mine]
    return label


def _taken(find: Find, track: Track, found: list[_Measured]) -> bool:
    """Whether a track is that of cables measured in the same round."""
    xyz = find.surface.xyz[track.rows]
    on = np.zeros(len(xyz), dtype=bool)
    for one in found:
        on |= _belongs(locate(one.axis, xyz), one.axis, one.radius_mm, one.result.noise_mm)
    return bool(on.mean() > WITHIN)


def _through(line: Float[np.ndarray, "m 3"], radius: float, other: _Measured) -> bool:
    """Whether a tenth of an axis lies so near another cable's that one would go through the other."""
    place = locate(other.axis, line)
    beside = (place.s > 0) & (place.s < other.axis.s[-1])
    near = np.hypot(place.u, place.v) < THROUGH * (radius + other.radius_mm)
    return bool((beside & near).mean() > 0.1)


def _in_any(track: Track, found: list[_Measured]) -> bool:
    return any(_through(track.axis, track.radius_mm, other) for other in found)


def _numbered(found: list[_Measured], limits: SearchLimits) -> list[_Measured]:
    """By the distance from the point that was given, else along the direction in which the axes' middles spread most."""
    middle = np.array([one.axis.xyz[len(one.axis.xyz) // 2] for one in found])
    if limits.near_mm is not None:
        point = np.array(limits.near_mm)
        order = [np.linalg.norm(one.axis.xyz - point, axis=1).min() for one in found]
    else:
        center, axes, _ = principal_axes(middle)
        order = (middle - center) @ facing_up(axes[0])
    return [found[row] for row in np.argsort(order, kind="stable")]
