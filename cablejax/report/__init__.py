"""Self-contained HTML pages and the figures on them."""

from cablejax.report.cables import cables_page, cables_picture
from cablejax.report.measurement import measurement_page
from cablejax.report.page import Page
from cablejax.report.scene import point_scene, point_views, scene_figure, thin
from cablejax.report.style import COLORS, LINES, data_uri, figure_style, line_styles, png_bytes

__all__ = [
    "COLORS",
    "LINES",
    "Page",
    "cables_page",
    "cables_picture",
    "data_uri",
    "figure_style",
    "line_styles",
    "measurement_page",
    "png_bytes",
    "point_scene",
    "point_views",
    "scene_figure",
    "thin",
]
