"""A cable's size from its scan: axis, sections, diameter, ovality, bend radius, each with what is known about it.

`measure_cable` does it all; the rest of the public names are its result and its parts that stand alone. This part runs
on the host in float64 NumPy and SciPy.
"""

from cablejax.measure.cable import measure_cable
from cablejax.measure.conformity import bend_conformity, conformity
from cablejax.measure.errors import MeasureError
from cablejax.measure.fit.beams import Instrument
from cablejax.measure.nominal import nominal_probabilities, verdict
from cablejax.measure.result import BudgetLine, CableMeasurement
from cablejax.measure.settings import MeasureSettings
from cablejax.measure.shape.free_section import FreeSection
from cablejax.measure.shape.irregularities import Irregularity, irregularities
from cablejax.measure.shape.sections import Sections

__all__ = [
    "BudgetLine",
    "CableMeasurement",
    "FreeSection",
    "Instrument",
    "Irregularity",
    "MeasureError",
    "MeasureSettings",
    "Sections",
    "bend_conformity",
    "conformity",
    "irregularities",
    "measure_cable",
    "nominal_probabilities",
    "verdict",
]
