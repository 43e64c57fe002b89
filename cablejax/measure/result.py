"""What a measurement returns."""

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from cablejax.measure.conformity import bend_conformity
from cablejax.measure.shape.free_section import FreeSection
from cablejax.measure.shape.irregularities import Irregularity, irregularities
from cablejax.measure.shape.sections import Sections
from cablejax.measure.shape.stretches import ONE, Stretch, changes


@dataclass(frozen=True)
class BudgetLine:
    """One source of uncertainty: its standard deviation of the diameter in mm, and how that was come by.

    `kind` is "A" where it was evaluated from the scan's own statistics, "B" where it comes from other knowledge (GUM).
    """

    source: str
    std_mm: float
    kind: str
    how: str


@dataclass(frozen=True)
class CableMeasurement:
    """A cable's size, with what is known about each number.

    Attributes:
        diameter_mm: Overall diameter of the section, of equal perimeter where the scan shows enough of it.
        std_mm: Its combined standard uncertainty.
        interval_mm: The 95 % interval.
        minimum_mm, maximum_mm: Least and greatest diameter, square to each other; None where the arc does not show them.
        ovality: Their difference over the mean diameter; None likewise.
        ovality_std: Its standard deviation; None likewise.
        length_mm: Length of the axis within the scan.
        bend_radius_mm: Radius of the axis where it bends most; None where it is straight within its uncertainty.
        bend_interval_mm: The 95 % interval of that radius; None likewise.
        arc_deg: Circumference seen, the median over the sections.
        noise_mm: Standard deviation of the points about the surface.
        points: Number of points that the diameter rests on.
        axis_mm: Points of the axis `[m, 3]`, in the coordinates of the scan.
        sections: Circles along the length.
        stretches: The length as stretches of constant or tapering diameter.
        form: In words: "one diameter", "tapers from 110 to 75 mm", or "not one diameter" with its range.
        keep: True for the scan's points that are the cable's `[n]`.
        deviation_mm: Distance of every point of the scan from the fitted surface `[n]`, positive outside; NaN far off.
        along_mm, angle_deg: Place of every point along the axis and about it `[n]`; NaN far off.
        budget: Sources of uncertainty.
        nominal: Probability of each nominal size, likeliest first; empty without a catalogue.
        free_section: The section's own shape; None where less than the whole circumference was seen.
        verdict: The nominal size in words; None without a catalogue.
        warnings: Sentences about what should be known before the numbers are used.
    """

    diameter_mm: float
    std_mm: float
    interval_mm: tuple[float, float]
    minimum_mm: float | None
    maximum_mm: float | None
    ovality: float | None
    ovality_std: float | None
    length_mm: float
    bend_radius_mm: float | None
    bend_interval_mm: tuple[float, float] | None
    arc_deg: float
    noise_mm: float
    points: int
    axis_mm: Float[np.ndarray, "m 3"]
    sections: Sections
    keep: Bool[np.ndarray, " n"]
    deviation_mm: Float[np.ndarray, " n"]
    along_mm: Float[np.ndarray, " n"]
    angle_deg: Float[np.ndarray, " n"]
    budget: tuple[BudgetLine, ...]
    nominal: dict[str, float] = field(default_factory=dict)
    verdict: str | None = None
    stretches: tuple[Stretch, ...] = ()
    form: str = ONE
    free_section: FreeSection | None = None
    warnings: tuple[str, ...] = ()

    @property
    def bend_verdicts(self) -> dict[str, str]:
        """The bend radius against 12, 15 and 20 diameters: "pass", "fail" or "undecided"."""
        return bend_conformity(self.bend_interval_mm, self.diameter_mm)

    @property
    def irregularities(self) -> list[Irregularity]:
        """Steps between stretches, bulges and dents of sections, in their order along the length."""
        steps = [
            Irregularity("step up" if size > 0 else "step down", at, at, size)
            for at, size, _ in changes(self.stretches)
        ]
        steep = [one for one in self.stretches if one.kind == "tapering"]
        local = [
            one
            for one in irregularities(self.sections)
            if not one.kind.startswith("step")
            and not any(part.from_mm - 1 <= one.from_mm <= part.to_mm + 1 for part in steep)
            and not any(one.from_mm - 1 <= step.from_mm <= one.to_mm + 1 for step in steps)
        ]
        return sorted([*steps, *local], key=lambda one: one.from_mm)

    def to_dict(self, *, arrays: bool = False) -> dict[str, Any]:
        """Plain numbers, lists and strings for JSON; the arrays as long as the scan only on request.

        Undefined numbers (NaN) become None, which JSON can hold.
        """
        out: dict[str, Any] = {
            "unit": "mm",
            **{name: getattr(self, name) for name in SCALARS},
            "interval_mm": list(self.interval_mm),
            "bend_interval_mm": None if self.bend_interval_mm is None else list(self.bend_interval_mm),
            "axis_mm": self.axis_mm.tolist(),
            "sections": {name: _listed(array) for name, array in self.sections._asdict().items()},
            "form": self.form,
            "stretches": [_told(one) for one in self.stretches],
            "free_section": None if self.free_section is None else _plain(self.free_section),
            "bend_conformity": self.bend_verdicts,
            "irregularities": [one._asdict() for one in self.irregularities],
            "budget": [asdict(line) for line in self.budget],
            "nominal": dict(self.nominal),
            "warnings": list(self.warnings),
        }
        if arrays:
            out["keep"] = self.keep.tolist()
            for name in ("deviation_mm", "along_mm", "angle_deg"):
                out[name] = _listed(getattr(self, name))
        return out


SCALARS = (
    "diameter_mm",
    "std_mm",
    "minimum_mm",
    "maximum_mm",
    "ovality",
    "ovality_std",
    "length_mm",
    "bend_radius_mm",
    "arc_deg",
    "noise_mm",
    "points",
    "verdict",
)


def _told(one: Stretch) -> dict[str, Any]:
    first, last = one.intervals_mm
    return {
        **one._asdict(),
        "length_mm": one.length_mm,
        "first_interval_mm": list(first),
        "last_interval_mm": list(last),
    }


def _plain(section: FreeSection) -> dict[str, Any]:
    return {
        name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in section._asdict().items()
    }


def _listed(array: np.ndarray) -> list[float | None]:
    return [float(value) if np.isfinite(value) else None for value in array]


@dataclass(frozen=True)
class NotMeasured:
    """Something round that was found and could not be measured.

    Attributes:
        diameter_mm: About how wide it is.
        length_mm: How far it could be followed.
        axis_mm: Points along it `[m, 3]`, in the coordinates of the scan.
        reason: Why there is no diameter, in words.
    """

    diameter_mm: float
    length_mm: float
    axis_mm: Float[np.ndarray, "m 3"]
    reason: str


@dataclass(frozen=True)
class CableScene:
    """Every cable of a scan.

    Attributes:
        cables: The measurements; a cable's number is its place among them, from 1.
        label: The number of the cable that each point of the scan belongs to `[n]`, 0 for none.
        not_measured: What looked like a cable and gave no diameter.
        warnings: Sentences about the scene; those about a cable are in its measurement.
    """

    cables: tuple[CableMeasurement, ...]
    label: Int[np.ndarray, " n"]
    not_measured: tuple[NotMeasured, ...]
    warnings: tuple[str, ...]

    def to_dict(self, *, arrays: bool = False) -> dict[str, Any]:
        """Plain numbers, strings and lists; the label of every point with `arrays`."""
        cables = [{"number": number, **one.to_dict(arrays=arrays)} for number, one in enumerate(self.cables, 1)]
        missed = [
            {
                **{name: getattr(one, name) for name in ("diameter_mm", "length_mm", "reason")},
                "axis_mm": one.axis_mm.tolist(),
            }
            for one in self.not_measured
        ]
        out = {"cables": cables, "not_measured": missed, "warnings": list(self.warnings)}
        return out | ({"label": self.label.tolist()} if arrays else {})
