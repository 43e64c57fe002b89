"""`cablejax register`: the rigid motion that takes one scan onto another."""

import argparse
from typing import Any

from cablejax.cli.main import NoResultError
from cablejax.cli.scans import WRITABLE, check_output, load, rows, save, say


def run(options: argparse.Namespace) -> dict[str, Any]:
    """Read both, register, write the moved source."""
    if options.output is not None:
        check_output(options.output, WRITABLE)
    source, target = load(options, options.source), load(options, options.target)
    from cablejax.registration import icp, register
    from cablejax.types import Status, describe

    say(options, f"registering {len(source.xyz_mm):,} points onto {len(target.xyz_mm):,}")
    if options.voxels:
        found = register(
            source.xyz_mm, target.xyz_mm, voxels=options.voxels, method=options.method, kernel=options.kernel
        )
    else:
        found = icp(
            source.xyz_mm,
            target.xyz_mm,
            method=options.method,
            kernel=options.kernel,
            max_distance=options.max_distance,
        )
    if found.status & Status.EMPTY:
        raise NoResultError(
            f"{options.source}: too few points lie near the target: give --max-distance, or bring the scans closer first"
        )
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
        "inliers": found.inliers,
        "rmse_mm": found.rmse,
        "observability": found.observability.tolist(),
        "unseen_directions": found.directions[:, ~found.seen].T.tolist(),
        "notes": describe(found.status),
    }


def table(result: dict[str, Any]) -> str:
    """The result for reading."""
    lines = ["  ".join(f"{value:14.8f}" for value in row) for row in result["T_target_source"]]
    unseen = len(result["unseen_directions"])
    pairs = [
        ("partners", f"{result['inliers']:,}, {result['rmse_mm']:.3g} mm apart (root mean square)"),
        ("converged", f"{'yes' if result['converged'] else 'no'}, after {result['iterations']} steps"),
        ("unseen", f"{unseen} of 6 directions of motion, left as they were" if unseen else "no direction of motion"),
    ]
    notes = [f"  note: {note}" for note in result["notes"]]
    return "\n".join(["  T_target_source, mm", *("  " + line for line in lines), rows(pairs), *notes])
