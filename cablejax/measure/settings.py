"""How a cable is sought and judged."""

from dataclasses import dataclass

from cablejax.measure.fit.beams import Instrument


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
            no sweeps to tell apart. None where it is not known.
        instrument: The scanner's noise and beam, by which their effects on the diameter are taken off more exactly.
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
    instrument: Instrument | None = None
    seed: int = 0

    def __post_init__(self) -> None:
        if self.stations is not None and self.stations < 1:
            raise ValueError(f"stations: expected at least 1, got {self.stations}")
