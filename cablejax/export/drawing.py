"""Axis and cylinder chain as a drawing (DXF) for CAD programs, in mm."""

import io
import os
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from cablejax.io import atomic_write
from cablejax.measure import CableMeasurement
from cablejax.optional import require

TOLERANCE = 0.003  # of the diameter, by which straight pieces may leave the axis
SIDES = 36


def write_drawing(path: str | os.PathLike[str], measured: CableMeasurement) -> None:
    """Write the axis as a polyline, a cylinder for each straight piece of it, and the diameter as text.

    Layers AXIS, CYLINDERS (meshes of `SIDES` faces) and TEXT; the drawing's unit is the millimetre, its coordinates those of
    the scan.

    Args:
        path: Ending in .dxf; replaced in one step.
        measured: The measurement.

    Raises:
        MissingPackageError: If ezdxf is not installed.
        OSError: If the file cannot be written.
    """
    require("ezdxf", why="a drawing (DXF)")
    import ezdxf
    from ezdxf.render.forms import cylinder_2p

    drawing = ezdxf.new("R2010", units=ezdxf.units.MM)  # pyright: ignore[reportAttributeAccessIssue, reportPrivateImportUsage]
    for name, color in (("AXIS", 1), ("CYLINDERS", 5), ("TEXT", 7)):
        drawing.layers.add(name, color=color)
    model, radius = drawing.modelspace(), measured.diameter_mm / 2
    pieces = straight_pieces(measured.axis_mm, TOLERANCE * measured.diameter_mm)
    model.add_polyline3d(measured.axis_mm.tolist(), dxfattribs={"layer": "AXIS"})
    for start, end in pairwise(pieces):
        tube = cylinder_2p(SIDES, radius, start.tolist(), end.tolist())
        tube.render_mesh(model, dxfattribs={"layer": "CYLINDERS"})
    low, high = measured.interval_mm
    text = f"diameter {measured.diameter_mm:.3f} mm (95 %: {low:.3f} to {high:.3f})"
    place = pieces[0] + [0.0, 0.0, 1.5 * radius]
    note = model.add_mtext(text, dxfattribs={"layer": "TEXT", "char_height": radius / 3})
    note.set_location(place.tolist())
    content = io.StringIO()
    drawing.write(content)
    with atomic_write(path) as file:
        file.write(content.getvalue().encode(drawing.output_encoding, errors="dxfreplace"))


def straight_pieces(xyz: Float[np.ndarray, "m 3"], tolerance: float) -> Float[np.ndarray, "p 3"]:
    """Some of the samples of a curve, such that the straight lines between them stay within a tolerance of the others.

    Douglas and Peucker (1973).
    """
    kept, todo = {0, len(xyz) - 1}, [(0, len(xyz) - 1)]
    while todo:
        first, last = todo.pop()
        if last - first < 2:
            continue
        offset, chord = xyz[first + 1 : last] - xyz[first], xyz[last] - xyz[first]
        along = np.clip(offset @ chord / max(float(chord @ chord), 1e-300), 0.0, 1.0)
        aside = np.linalg.norm(offset - along[:, None] * chord, axis=1)
        worst = int(np.argmax(aside))
        if aside[worst] > tolerance:
            middle = first + 1 + worst
            kept.add(middle)
            todo += [(first, middle), (middle, last)]
    return xyz[sorted(kept)]
