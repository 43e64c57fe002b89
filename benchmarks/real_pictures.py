"""Pictures of real scans of known size: three whose interval holds, three that miss or are refused.

    CABLEJAX_DATA=... python -m benchmarks.real_pictures --out results/figures/real_scans.png

Each scan is measured anew and drawn along its axis with the fitted circle and the true one; a refused one is drawn as it
lies, in its two widest directions.
"""

import argparse
import os
import textwrap
from pathlib import Path

import numpy as np

from benchmarks.real import truths, verdict
from cablejax.io import read_points
from cablejax.measure import CableMeasurement, MeasureError, measure_cable
from cablejax.report import COLORS, figure_style, png_bytes, thin

SCANS = (
    ("posecnn3_soup", "ziso_wrs14_motorA", "tb_tree31_bh"),
    ("zcan_wrs14_motorA", "ziso_wrs14_pins_3", "ziso_wrs14_shafts_7"),
)


def panel(ax, xyz: np.ndarray, result: CableMeasurement | None, truth: str) -> None:
    """One scan: along its axis, or as it lies."""
    if result is None:
        rows = xyz[thin(len(xyz))] - xyz.mean(axis=0)
        across = np.linalg.svd(rows, full_matrices=False)[2][:2]
        ax.plot(*(rows @ across.T).T, ".", ms=0.6, color="grey", ls="none", rasterized=True)
        ax.set(xlabel="mm", ylabel="mm")
        return
    on = np.flatnonzero(result.keep)
    on = on[thin(len(on))]
    angle = np.radians(result.angle_deg[on])
    scale = result.diameter_mm / 2 + result.deviation_mm[on]
    ax.plot(scale * np.cos(angle), scale * np.sin(angle), ".", ms=0.6, color=COLORS[0], ls="none", rasterized=True)
    turn = np.linspace(0, 2 * np.pi, 200)
    for value, color, line in [
        (result.diameter_mm, COLORS[6], "-"),
        *((float(one), COLORS[2], "--") for one in truth.split(" or ")),
    ]:
        ax.plot(0.5 * value * np.cos(turn), 0.5 * value * np.sin(turn), color=color, ls=line, lw=1)
    ax.set(xlabel="across the axis (mm)", ylabel="across (mm)")


def main() -> None:
    """Measure six scans and draw them."""
    from matplotlib.figure import Figure

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", default="results/figures/real_scans.png")
    options = parser.parse_args()
    folder = Path(os.environ.get("CABLEJAX_DATA", "../shared/data")) / "real"
    known = {one["scan"]: one["truth"] for one in truths(folder)}
    with figure_style():
        figure = Figure(figsize=(9.0, 6.4))
        for ax, name in zip(figure.subplots(2, 3).flat, [name for row in SCANS for name in row], strict=True):
            xyz = read_points(folder / f"{name}.ply", unit="mm").xyz_mm
            result, row = None, {}
            try:
                result = measure_cable(xyz)
                row = {"interval_mm": result.interval_mm}
                told = f"{result.diameter_mm:.1f} mm [{row['interval_mm'][0]:.1f}, {row['interval_mm'][1]:.1f}]"
                told += "" if result.form == "one diameter" else f"\n{result.form}"
            except MeasureError as error:
                row = {"refused": str(error)}
                told = textwrap.shorten(
                    str(error).removeprefix("The diameter cannot be told: "), 90, placeholder=" ..."
                )
            told = "\n".join(line for part in told.splitlines() for line in textwrap.wrap(part, 48))
            panel(ax, xyz, result, known[name])
            ax.set_aspect("equal", adjustable="datalim")
            ax.set_title(f"{name}: {verdict(known[name], row)}, true {known[name]} mm\n{told}", fontsize=7, loc="left")
        Path(options.out).write_bytes(png_bytes(figure))


if __name__ == "__main__":
    main()
