"""A measurement handed on to other programs: deviations in point files, tables, drawings, a page to print."""

from cablejax.export.deviations import write_deviations
from cablejax.export.drawing import write_drawing
from cablejax.export.protocol import protocol_page
from cablejax.export.tables import write_axis, write_sections

__all__ = ["protocol_page", "write_axis", "write_deviations", "write_drawing", "write_sections"]
