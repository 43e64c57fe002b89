"""A cable's size from its scan: axis, sections, diameter, ovality, bend radius, each with what is known about it.

`measure_cable` does it all, `measure_cables` for every cable of a scene; the rest of the public names are their results and
their parts that stand alone. This part runs on the host in float64 NumPy and SciPy.
"""

from cablejax.measure.cable import measure_cable, measure_labelled
from cablejax.measure.cables import measure_cables
from cablejax.measure.conformity import bend_conformity, conformity
from cablejax.measure.errors import MeasureError
from cablejax.measure.fit.beam_noise import Instrument
from cablejax.measure.labelled import LabelledMeasurement, PointLabels
from cablejax.measure.nominal import nominal_probabilities, verdict
from cablejax.measure.result import BudgetLine, CableMeasurement, CableScene, NotMeasured
from cablejax.measure.settings import MeasureSettings, SearchLimits
from cablejax.measure.shape.free_section import FreeSection
from cablejax.measure.shape.irregularities import Irregularity, irregularities
from cablejax.measure.shape.sections import Sections
from cablejax.measure.shape.stretches import Stretch

__all__ = [
    "BudgetLine",
    "CableMeasurement",
    "CableScene",
    "FreeSection",
    "Instrument",
    "Irregularity",
    "LabelledMeasurement",
    "MeasureError",
    "MeasureSettings",
    "NotMeasured",
    "PointLabels",
    "SearchLimits",
    "Sections",
    "Stretch",
    "bend_conformity",
    "conformity",
    "irregularities",
    "measure_cable",
    "measure_cables",
    "measure_labelled",
    "nominal_probabilities",
    "verdict",
]
