"""How a cable is sought and judged."""

import math
from dataclasses import dataclass, field

from cablejax.measure.depth_image import LENS_STD
from cablejax.measure.fit.beam_noise import Instrument

Point = tuple[float, float, float]


@dataclass(frozen=True)
class SearchLimits:
    """What is known of the cables that are sought; what is left out is not limited.

    Attributes:
        diameter_mm: Least and greatest diameter.
        axis: A direction that the cables run along, within `AXIS_DEG` and of either sign; any length but zero.
        near_mm: A point near the cable that is sought: the nearest one is measured, or the numbers go by the distance.
        box_mm: Two opposite corners; points outside are not looked at.
    """

    diameter_mm: tuple[float, float] | None = None
    axis: Point | None = None
    near_mm: Point | None = None
    box_mm: tuple[Point, Point] | None = None

    def __post_init__(self) -> None:
        if self.diameter_mm is not None and not 0 <= self.diameter_mm[0] < self.diameter_mm[1]:
            low, high = self.diameter_mm
            raise ValueError(f"diameter_mm: expected 0 <= low < high, got {low:g} {high:g}")
        if self.axis is not None and not 0 < math.hypot(*self.axis) < math.inf:
            raise ValueError(f"axis: expected a direction that is not zero, got {self.axis}")
        if self.near_mm is not None and not all(math.isfinite(x) for x in self.near_mm):
            raise ValueError(f"near_mm: expected finite coordinates, got {self.near_mm}")
        if self.box_mm is not None and not all(a != b for a, b in zip(*self.box_mm, strict=True)):
            raise ValueError(f"box_mm: expected two corners that differ in every coordinate, got {self.box_mm}")

    def in_words(self) -> str:
        """What was asked for, for a message; empty without limits."""
        words = []
        if self.diameter_mm is not None:
            words.append("diameters of {:g} to {:g} mm".format(*self.diameter_mm))
        if self.axis is not None:
            words.append("axes along ({:g}, {:g}, {:g})".format(*self.axis))
        if self.box_mm is not None:
            words.append("points in the box")
        return ", ".join(words)


@dataclass(frozen=True)
class MeasureSettings:
    """How a cable is sought and judged.

    Attributes:
        min_arc_deg: Least circumference that must be seen; below it the diameter is not reported.
        oval_arc_deg: Least circumference on which ovality is reported.
        section_mm: Distance between sections; a quarter of the diameter if None, and at most 200 sections.
        registration_std_mm: Standard deviation of the stations' alignment, for the budget.
        scale_std: Relative standard deviation of the scanner's scale, for the budget.
        filter_std_mm: Standard deviation that a filter applied before has left in the diameter, for the budget.
        maker_std_mm: Standard deviation of the makers' diameters about the catalogue's, for the nominal size.
        stations: Number of scanner positions, where it is known: 1 for a single view, which has no alignment to doubt and
            no sweeps to tell apart. None where it is not known; a scan that lies on the pixels of a depth image is then a
            single view.
        lens_std: Standard deviation of the first radial coefficient of the lens distortion that a scan from a depth image
            may still hold; 0 where the image was rectified.
        instrument: The scanner's noise and beam, by which their effects on the diameter are taken off more exactly.
        limits: What is known of the cables that are sought.
        seed: Of the random samples with which the cable is sought.
    """

    min_arc_deg: float = 40.0
    oval_arc_deg: float = 175.0
    section_mm: float | None = None
    registration_std_mm: float = 0.0
    scale_std: float = 0.0
    filter_std_mm: float = 0.0
    maker_std_mm: float = 0.0
    stations: int | None = None
    lens_std: float = LENS_STD
    instrument: Instrument | None = None
    limits: SearchLimits = field(default_factory=SearchLimits)
    seed: int = 0

    def __post_init__(self) -> None:
        if self.stations is not None and self.stations < 1:
            raise ValueError(f"stations: expected at least 1, got {self.stations}")
        if not 0 <= self.lens_std < math.inf:
            raise ValueError(f"lens_std: expected a number of at least 0, got {self.lens_std!r}")
