"""`cablejax simulate`: a scan of a catalogue cable with known truth."""

import argparse
import io
from typing import Any

from cablejax.cli.errors import NoResultError
from cablejax.cli.scans import WRITABLE, check_output, rows, save, save_bytes, say
from cablejax.optional import require

HELP = "write a simulated scan of a catalogue cable, its true diameter beside it"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    parser.add_argument("output", help="file to write: .ply, .pcd, .xyz, .csv, .las or .laz")
    parser.add_argument("--size", type=float, default=240, metavar="MM2", help="conductor cross-section (default: 240)")
    parser.add_argument("--voltage", default="8.7/15", metavar="KV", help="rated voltage U0/U (default: 8.7/15)")
    parser.add_argument("--points", type=int, default=53_135, help="default: 53135")
    parser.add_argument("--preset", default="line-laser", help="scanner (default: line-laser)")
    parser.add_argument(
        "--shape",
        default="straight",
        help="line, sheath or accessory, surrounding: bend, corrugated+tray (default: straight)",
    )
    parser.add_argument("--bend-radius", type=float, metavar="MM", help="default: 15 diameters")
    parser.add_argument("--finish", default="matte", help="matte, dark, glossy or dark-glossy (default: matte)")
    parser.add_argument("--length", type=float, default=400.0, metavar="MM", help="default: 400")
    parser.add_argument("--arc", type=float, default=360.0, metavar="DEG", help="circumference seen (default: 360)")
    parser.add_argument("--outliers", type=float, default=0.02, metavar="SHARE", help="default: 0.02")
    parser.add_argument("--seed", type=int, default=0, help="default: 0")
    parser.add_argument(
        "--picture", metavar="PNG", help="also draw the scan, coloured by its distance to the true surface"
    )


def run(options: argparse.Namespace) -> dict[str, Any]:
    """Simulate and write."""
    check_output(options.output, WRITABLE)
    if options.picture:
        require("matplotlib", why="--picture")
        check_output(options.picture, (".png",))
    import jax
    import numpy as np

    from cablejax.simulate import catalogue, simulate_scan

    try:
        sizes = {cable.size_mm2: cable for cable in catalogue(options.voltage)}
        if options.size not in sizes:
            known = ", ".join(f"{size:g}" for size in sizes)
            raise ValueError(f"size: expected one of {known} mm2, got {options.size:g}")
        say(options, f"simulating {options.points:,} points")
        scan = simulate_scan(
            sizes[options.size],
            n_points=options.points,
            preset=options.preset,
            shape=options.shape,
            length_mm=options.length,
            bend_radius_mm=options.bend_radius,
            finish=options.finish,
            arc_deg=options.arc,
            outlier_fraction=options.outliers,
            key=jax.random.key(options.seed),
        )
    except ValueError as error:
        raise NoResultError(str(error)) from None
    save(options.output, np.asarray(scan.xyz_mm, dtype=np.float64))
    if options.picture:
        _draw(scan, options.picture)
    return {
        "output": options.output,
        "unit": "mm",
        "points": len(scan.xyz_mm),
        "true_diameter_mm": float(scan.true_diameter_mm),
        "cable": sizes[options.size].name,
        "shape": scan.shape,
        "preset": scan.preset,
        "finish": scan.finish,
        "outliers": int(scan.is_outlier.sum()),
        "seed": options.seed,
        "picture": options.picture,
    }


def _draw(scan: Any, path: str) -> None:
    """The scan from aslant, and its deviation from the true surface round the cable."""
    import jax
    import numpy as np
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    kept = np.flatnonzero(~np.asarray(scan.is_outlier))
    xyz, off = np.asarray(scan.xyz_mm)[kept], np.asarray(scan.signed_distance_mm)[kept]
    reach = max(float(np.quantile(np.abs(off), 0.99)), 1e-4)
    figure = Figure(figsize=(9, 5.2), layout="constrained")
    FigureCanvasAgg(figure)
    view, around = figure.subplots(2, 1, height_ratios=(2, 3))
    order = np.argsort(0.56 * xyz[:, 2] - 0.83 * xyz[:, 1])  # far to near, seen from in front and above
    flat = xyz[order, 0], (0.83 * xyz[:, 2] + 0.56 * xyz[:, 1])[order]
    dots = view.scatter(*flat, s=0.6, c=off[order], cmap="coolwarm", vmin=-reach, vmax=reach, linewidths=0)
    view.set(aspect="equal", xlabel="mm", title=f"{scan.shape}, {scan.preset}, {len(scan.xyz_mm):,} points")
    figure.colorbar(dots, ax=view, label="mm off the surface", shrink=0.8)
    place = jax.jit(jax.vmap(scan.surface.locate))(scan.xyz_mm)
    around.scatter(np.degrees(np.asarray(place.angle)[kept]), off, s=0.4, c="#3b6ea5", linewidths=0)
    around.set(
        xlim=(-180, 180),
        ylim=(-2 * reach, 2 * reach),
        xlabel="degrees round the cable",
        ylabel="mm off the true surface",
    )
    around.set_title(f"{scan.true_diameter_mm:.1f} mm wide, standard deviation {off.std():.3f} mm", fontsize=10)
    image = io.BytesIO()
    figure.savefig(image, dpi=100, format="png")
    save_bytes(path, image.getvalue())


def table(result: dict[str, Any]) -> str:
    """The result for reading."""
    return rows(
        [
            ("written", f"{result['output']}, in mm"),
            ("cable", f"{result['cable']}, true diameter {result['true_diameter_mm']:.3f} mm"),
            ("scan", f"{result['points']:,} points, {result['preset']}, {result['shape']}"),
            ("outliers", f"{result['outliers']:,}"),
            *([("picture", result["picture"])] if result["picture"] else []),
        ]
    )
