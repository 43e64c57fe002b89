"""From a scan to a diameter: find the cable, fit its axis and radius, and say how well each number is known."""

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Int, Num

from cablejax.measure.accept import first_that_fits
from cablejax.measure.agree import CLEAR, confirmed
from cablejax.measure.assemble import assembled
from cablejax.measure.find.cables import find_cables
from cablejax.measure.labelled import LabelledMeasurement, PointLabels, decided
from cablejax.measure.result import CableMeasurement
from cablejax.measure.scan import Scan, scan_of
from cablejax.measure.settings import MeasureSettings

if TYPE_CHECKING:
    from cablejax.types import PointCloud


def measure_cable(
    cloud_or_xyz_mm: "PointCloud | Num[np.ndarray, 'n 3']",
    *,
    station: Int[np.ndarray, " n"] | None = None,
    on_cable: Bool[np.ndarray, " n"] | None = None,
    labels: PointLabels | None = None,
    catalogue: Mapping[str, float] | None = None,
    settings: MeasureSettings | None = None,
) -> CableMeasurement:
    """Find the cable in a scan and measure it.

    Flat clutter is taken out, cylinders are sought by random samples, the best one is followed along its bends, and one
    radius with a smooth axis is fitted by robust least squares to the scan's own points, unfiltered: a filter would
    narrow the scatter and shift the surface. Noise widens a diameter by its square over the radius; that is taken off.

    Args:
        cloud_or_xyz_mm: The scan `[n, 3]` in millimetres, or a padded cloud. Rows with NaN are passed over. float64 is
            kept where it is given.
        station: Number of the scanner position of each point `[n]`, where the scan was put together from several: each
            position's shift is then fitted as well, and does not widen the diameter.
        on_cable: Which points may be the cable's `[n]`, where something has told, such as a network that labels parts
            (`cablejax.nets.label_parts`); the others are passed over. None lets all be looked at.
        labels: What a network says of the points, where it is to be believed only against a search that it does not confirm:
            the scan is measured with and without, and where the two disagree a warning tells both (`cablejax.measure.labelled`).
        catalogue: Overall diameter in mm of each nominal size by name, to tell the size from the diameter.
        settings: Thresholds and what is known of the scanner.

    Returns:
        The measurement; its arrays `keep` and `deviation_mm` have a row per row of the scan.

    Raises:
        MeasureError: If the scan does not hold a cable that can be measured, with the reason in words.
        ValueError: If the scan is not `[n, 3]`, or `on_cable` not one truth value a row.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> angle, along = rng.uniform(0, np.pi, 4000), rng.uniform(0, 200, 4000)
        >>> xyz = np.stack([along, 10 * np.cos(angle), 10 * np.sin(angle)], axis=1)
        >>> result = measure_cable(xyz + 0.05 * rng.normal(size=xyz.shape))
        >>> abs(result.diameter_mm - 20) < 0.02
        True
    """
    settings = settings if settings is not None else MeasureSettings()
    if labels is not None:
        if on_cable is not None:
            raise ValueError("labels: expected none beside on_cable, which leaves the other points out")
        given: dict[str, Any] = {"station": station, "catalogue": catalogue, "settings": settings}
        return measure_labelled(cloud_or_xyz_mm, lambda: labels, **given).result
    # 1. The points that are looked at, near the origin in float64.
    scan = scan_of(cloud_or_xyz_mm, station=station, on_cable=on_cable, limits=settings.limits)
    settings = scan.views(settings)
    # 2. Search, fit and judge; in clutter again with other random samples, since one search may be misled.
    first = _searched(scan, catalogue, settings, settings.seed)
    if first.keep.sum() > CLEAR * len(scan.xyz):
        return first
    return confirmed(first, lambda seed: _searched(scan, catalogue, settings, seed), settings.seed)


def measure_labelled(
    cloud_or_xyz_mm: "PointCloud | Num[np.ndarray, 'n 3']", label: Callable[[], PointLabels], **given: Any
) -> LabelledMeasurement:
    """`measure_cable` without and with labels: both candidates, and the one that is told.

    Args:
        cloud_or_xyz_mm: As in `measure_cable`.
        label: Gives what a network says of the points; called only where other things lie beside the cable that was found.
        given: The other arguments of `measure_cable`.

    Raises:
        MeasureError: If the scan holds no cable that can be measured.
        ValueError: As `measure_cable`, or if there is not a label for each row.
    """
    return decided(lambda on_cable: measure_cable(cloud_or_xyz_mm, **{**given, "on_cable": on_cable}), label)


def _searched(
    scan: Scan, catalogue: Mapping[str, float] | None, settings: MeasureSettings, seed: int
) -> CableMeasurement:
    """One search and what it finds.

    Raises:
        MeasureError: If that is no cable, or none that can be measured.
    """
    # 1. Flat regions out, cylinders sought, the best ones followed along their bends.
    find = find_cables(scan.xyz, rng=np.random.default_rng(seed), limits=scan.moved(settings.limits))
    # 2. One radius and a smooth axis fitted to all points about the best track that turns out to be round.
    one = first_that_fits(scan, find, settings)
    # 3. The numbers, each with what is known about it.
    return assembled(one, find, catalogue, settings)
