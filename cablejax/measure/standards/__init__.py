"""Numbers as the standards write them: readings, sizes of a section, and the capability of the measurement itself."""

from cablejax.measure.standards.gage import GageStudy, gage_study
from cablejax.measure.standards.iec60811 import Readings, readings
from cablejax.measure.standards.iso14405 import SectionSizes, section_sizes

__all__ = ["GageStudy", "Readings", "SectionSizes", "gage_study", "readings", "section_sizes"]
