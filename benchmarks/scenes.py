"""Scenes of several cables with the simulator, measured by `measure_cables`: `python -m benchmarks.scenes --out FILE.json`.

A tray with twelve cables of the catalogue's sizes seen from above, and a trefoil seen all round, each with `--seeds` random
keys; how many are found, how many more, and how many of their intervals hold. `--picture` draws the first tray.
"""

import argparse
import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import record
from cablejax.measure import CableScene, MeasureError, measure_cables
from cablejax.report import cables_picture
from cablejax.simulate import catalogue
from cablejax.simulate.clutter import Scene, box, neighbour, trefoil
from cablejax.simulate.presets import scanner
from cablejax.simulate.scan import scan_scene
from cablejax.simulate.shapes import make_tube
from cablejax.simulate.surface import Part

SCANNED = 5  # which cable of the tray the simulator takes for the scanned one: one in the middle
GAPS_MM = (0.0, 4.0, 0.0, 12.0, 3.0, 0.0, 20.0, 6.0, 0.0, 8.0, 2.0)  # between one cable of the tray and the next
LENGTH_MM = 600.0


def tray(seed: int, points: int) -> tuple[np.ndarray, dict[tuple[float, float], float]]:
    """Points `[n, 3]`, and the diameter of the cable at each place across and up."""
    diameters = np.array([float(cable.diameter_mm) for cable in catalogue()][:12])
    across = np.concatenate([[0.0], np.cumsum(0.5 * (diameters[1:] + diameters[:-1]) + GAPS_MM)])
    across -= across[SCANNED]
    radius = diameters[SCANNED] / 2
    up = diameters / 2 - radius
    tube = make_tube("straight", diameter_mm=2 * float(radius), length_mm=LENGTH_MM)
    solids: list[Any] = [
        neighbour(tube, *(jnp.float32(value) for value in (across[i], up[i], diameters[i] / 2)))
        for i in range(12)
        if i != SCANNED
    ]
    low, high = float(across[0] - 25), float(across[-1] + 35)
    solids.append(box((0.0, 0.5 * (low + high), float(-radius) - 0.75), (300.0, 0.5 * (high - low), 0.75), Part.TRAY))
    solids += [box((0.0, side, float(-radius) + 30.0), (300.0, 0.75, 30.0), Part.TRAY) for side in (low, high)]
    scene = Scene(tube, tuple(solids), jnp.float32(max(-low, high) + 5.0 - radius))
    scan = scan_scene(scene, device=scanner("line-laser"), n_points=points, arc_deg=150.0, key=jax.random.key(seed))
    places = zip(across.tolist(), up.tolist(), strict=True)
    return np.asarray(scan.xyz_mm, np.float64), dict(zip(places, diameters.tolist(), strict=True))


def three(seed: int, points: int) -> tuple[np.ndarray, dict[tuple[float, float], float]]:
    """The same of three touching cables of 30 mm."""
    scene = trefoil(make_tube("straight", diameter_mm=30.0, length_mm=400.0))._replace(view_mm=jnp.float32(50.0))
    scan = scan_scene(scene, device=scanner("line-laser"), n_points=points, stations=4, key=jax.random.key(seed))
    down = -(3**0.5) * 15.0
    return np.asarray(scan.xyz_mm, np.float64), dict.fromkeys([(0.0, 0.0), (15.0, down), (-15.0, down)], 30.0)


SCENES = {"tray with 12 cables": (tray, 120_000), "trefoil": (three, 60_000)}


def judged(found: CableScene, truth: dict[tuple[float, float], float]) -> dict[str, Any]:
    """How many of the true cables were found, with their errors; the others that were found are false."""
    errors, held, left = [], 0, dict(truth)
    for one in found.cables:
        middle = one.axis_mm.mean(axis=0)[1:]
        place = min(left, key=lambda at: float(np.hypot(*(middle - at))), default=None)
        if place is None or np.hypot(*(middle - place)) > left[place] / 4:
            continue
        diameter = left.pop(place)
        errors.append(one.diameter_mm - diameter)
        held += one.interval_mm[0] <= diameter <= one.interval_mm[1]
    return {"found": len(errors), "false": len(found.cables) - len(errors), "held": held, "errors_mm": errors}


def main() -> None:
    """Measure, print, and write what is asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--out", help="JSON file to write")
    parser.add_argument("--picture", help="PNG of the first tray")
    options = parser.parse_args()
    rows = []
    for name, (make, points) in SCENES.items():
        for seed in range(options.seeds):
            xyz, truth = make(seed, points)
            start = time.process_time()
            row: dict[str, Any] = {"scene": name, "seed": seed, "cables": len(truth)}
            try:
                found = measure_cables(xyz)
                row |= judged(found, truth)
                if options.picture and not rows:
                    Path(options.picture).write_bytes(cables_picture(found, xyz))  # pyright: ignore[reportArgumentType] frozen
            except MeasureError as error:
                row["refused"] = str(error)
            rows.append({**row, "cpu_s": time.process_time() - start})
            print(rows[-1], flush=True)
    if options.out:
        record.write(options.out, {"scenes": record.table(rows)}, seeds=range(options.seeds))


if __name__ == "__main__":
    main()
