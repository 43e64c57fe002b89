"""`cablejax register`: the rigid motions that bring two or more scans together."""

import argparse
from typing import TYPE_CHECKING, Any

from cablejax.cli.arguments import UNITS, add_columns
from cablejax.cli.errors import NoResultError
from cablejax.cli.scans import WRITABLE, check_output, load, rows, save, say

if TYPE_CHECKING:
    from cablejax.io import PointFile
    from cablejax.registration import RegistrationResult


HELP = "the rigid motions that bring scans together"
DESCRIPTION = "Bring scans into the frame of the last one: two by one registration, more by a pose graph."


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    parser.add_argument("scans", nargs="+", metavar="scan", help="point files, two or more; the last one stays")
    parser.add_argument("--unit", choices=UNITS, help="unit of all files (default: mm, with a warning)")
    add_columns(parser)
    parser.add_argument(
        "--output", metavar="FILE", help="write the moved source, or all scans together if more than two"
    )
    parser.add_argument("--method", choices=("point", "plane", "gicp"), default="gicp", help="default: gicp")
    parser.add_argument("--kernel", choices=("none", "huber", "cauchy", "tukey"), default="none", help="default: none")
    parser.add_argument(
        "--max-distance",
        type=float,
        metavar="MM",
        help="register once, from where the scans lie, with corresponding points no further apart",
    )
    parser.add_argument(
        "--voxels",
        type=float,
        nargs="+",
        metavar="MM",
        help="from coarse to fine: 500 250 125, corresponding points within 4 voxels (2 for more than two scans); two scans "
        "find their own",
    )
    parser.add_argument(
        "--start",
        choices=("given", "features"),
        help="with --voxels: given, the scans lie near each other as they are (default), or features, nothing is known of the "
        "pose; without, several starts are compared",
    )


def run(options: argparse.Namespace) -> dict[str, Any]:
    """Read all, register, write what was moved."""
    if len(options.scans) < 2:
        raise NoResultError(f"scans: expected two files or more, got {len(options.scans)}")
    if options.voxels is None and len(options.scans) > 2:
        raise NoResultError("--voxels: are needed for more than two scans, coarse to fine in mm")
    if options.output is not None:
        check_output(options.output, WRITABLE)
    scans = [load(options, path) for path in options.scans]
    try:
        return _pair(options, *scans) if len(scans) == 2 else _stations(options, scans)
    except ValueError as error:
        raise NoResultError(str(error)) from None


def _pair(options: argparse.Namespace, source: "PointFile", target: "PointFile") -> dict[str, Any]:
    """One onto the other."""
    from cablejax.registration import icp, register, register_auto
    from cablejax.types import Status, describe

    say(options, f"registering {len(source.xyz_mm):,} points onto {len(target.xyz_mm):,}")
    tried: dict[str, Any] = {"voxels_mm": options.voxels, "start": options.start or "given", "doubts": []}
    if options.voxels:
        found = register(
            source.xyz_mm, target.xyz_mm, voxels=options.voxels, method=options.method, kernel=options.kernel,
            start=options.start or "given",
        )  # fmt: skip
    elif options.max_distance is not None:
        found = icp(
            source.xyz_mm, target.xyz_mm, method=options.method, kernel=options.kernel,
            max_distance=options.max_distance,
        )  # fmt: skip
    else:
        best = register_auto(source.xyz_mm, target.xyz_mm, method=options.method, kernel=options.kernel)
        found = best.result
        tried = {"voxels_mm": list(best.voxels), "start": best.start, "doubts": list(best.doubts)}
    if found.status & Status.EMPTY:
        raise NoResultError(f"{options.scans[0]}: too few points lie near the target: leave --max-distance out")
    if options.output is not None:
        moved = source.xyz_mm @ found.T_target_source[:3, :3].T + found.T_target_source[:3, 3]
        save(options.output, moved, unit=source.unit, color=source.color, intensity=source.intensity)
    return {
        "source": str(source.path),
        "target": str(target.path),
        "T_target_source": found.T_target_source.tolist(),
        "unit": "mm",
        "converged": found.converged,
        "iterations": found.iterations,
        **_described(found),
        "notes": describe(found.status),
        **tried,
    }


def _described(found: "RegistrationResult") -> dict[str, Any]:
    return {
        "inliers": found.inliers,
        "overlap": found.overlap,
        "rmse_mm": found.rmse,
        "observability": found.observability.tolist(),
        "unseen_directions": found.directions[:, ~found.seen].T.tolist(),
    }


def _stations(options: argparse.Namespace, scans: "list[PointFile]") -> dict[str, Any]:
    """All into the frame of the last, by a pose graph."""
    import numpy as np

    from cablejax.registration import register_stations

    say(options, f"registering {len(scans)} scans, {sum(len(scan.xyz_mm) for scan in scans):,} points")
    order = scans[::-1]  # the first one's frame is the world
    found = register_stations(
        [scan.xyz_mm for scan in order], voxels=options.voxels, method=options.method, kernel=options.kernel,
        start=options.start or "given",
    )  # fmt: skip
    if options.output is not None:
        poses = found.T_world_station
        moved = [scan.xyz_mm @ T[:3, :3].T + T[:3, 3] for scan, T in zip(order, poses, strict=True)]
        save(options.output, np.concatenate(moved), unit=scans[-1].unit)
    return {
        "files": options.scans,
        "T_last_file": [T.tolist() for T in found.T_world_station[::-1]],
        "unit": "mm",
        "rmse_mm": found.rmse,
        "pairs": [
            {"source": str(order[source].path), "target": str(order[target].path), **_described(pair)}
            for (source, target), pair in found.pairs.items()
        ],
    }


def table(result: dict[str, Any]) -> str:
    """The result for reading."""
    if "files" in result:
        return _stations_table(result)
    unseen = len(result["unseen_directions"])
    pairs = [
        ("correspondences", f"{result['inliers']:,}, {result['rmse_mm']:.3g} mm apart (root mean square)"),
        ("converged", f"{'yes' if result['converged'] else 'no'}, after {result['iterations']} steps"),
        ("unseen", f"{unseen} of 6 directions of motion, left as they were" if unseen else "no direction of motion"),
    ]
    if result["voxels_mm"]:
        sides = " ".join(f"{side:.3g}" for side in result["voxels_mm"])
        pairs.append(("began", f"{result['start']}, voxels of {sides} mm"))
    notes = [f"  note: {note}" for note in result["notes"]] + [f"  doubt: {text}" for text in result["doubts"]]
    return "\n".join(["  T_target_source, mm", _matrix(result["T_target_source"]), rows(pairs), *notes])


def _matrix(T: list[list[float]]) -> str:
    return "\n".join("    " + "  ".join(f"{value:14.8f}" for value in row) for row in T)


def _stations_table(result: dict[str, Any]) -> str:
    lines = []
    for path, T in zip(result["files"], result["T_last_file"], strict=True):
        lines += [f"  {path}, into the frame of the last, mm", _matrix(T)]
    pairs = [
        (
            f"{pair['source']} onto {pair['target']}",
            f"{100 * pair['overlap']:.0f} % overlap, {pair['rmse_mm']:.3g} mm, {len(pair['unseen_directions'])} of 6 unseen",
        )
        for pair in result["pairs"]
    ]
    return "\n".join([*lines, rows(pairs)])
