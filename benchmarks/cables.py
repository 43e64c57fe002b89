"""The filter's defaults on cables of 5 to 120 mm and noise of 0.02 to 1 mm: `python -m benchmarks.cables`.

Half-cylinders of 20,000 points, three diameters long, noise along the normal; order 2 with no parameter given. What is left
of the noise and the bias of the diameter are of the points away from the cut edges.
"""

import argparse
from pathlib import Path

import numpy as np

from benchmarks import record
from cablejax.ops import adaptive_filter
from cablejax.types import PointCloud

RESULT = Path("results/benchmarks/cables.json")
DIAMETERS_MM = (5.0, 15.0, 40.0, 120.0)
NOISE_MM = (0.02, 0.1, 0.385, 1.0)
POINTS = 20_000


def cable(diameter: float, noise: float, seed: int) -> np.ndarray:
    """Points of a half-cylinder along z."""
    rng = np.random.default_rng(seed)
    angle, radius = rng.uniform(0, np.pi, POINTS), diameter / 2 + noise * rng.normal(size=POINTS)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), rng.uniform(0, 3 * diameter, POINTS)], axis=1)


def measure(diameter: float, noise: float, order: int, seed: int) -> dict[str, float]:
    """Standard deviation left and twice the mean deviation, away from the edges."""
    xyz = cable(diameter, noise, seed)
    inside = (np.abs(xyz[:, 2] / diameter - 1.5) < 1.2) & (xyz[:, 1] > 0.2 * diameter)
    result = adaptive_filter(PointCloud.from_xyz(xyz), order=order)
    out = np.asarray(result.xyz, dtype=np.float64)[: len(xyz)]
    left = (np.hypot(out[:, 0], out[:, 1]) - diameter / 2)[inside]
    width = float(np.median(np.asarray(result.width)[: len(xyz)]))
    return {"std_mm": float(left.std()), "diameter_bias_mm": 2 * float(left.mean()), "width_mm": width}


def main() -> None:
    """Filter every cell of the grid, print and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--order", type=int, choices=(0, 1, 2), default=2)
    parser.add_argument("--write", action="store_true", help=f"write {RESULT}")
    options = parser.parse_args()
    rows = []
    print(f"{'diameter':>9s}{'noise':>8s}{'left':>9s}{'share':>8s}{'bias of D':>11s}{'width':>8s}   mm")
    for diameter in DIAMETERS_MM:
        for noise in NOISE_MM:
            row = measure(diameter, noise, options.order, seed=7)
            rows.append({"diameter_mm": diameter, "noise_mm": noise, **row})
            print(
                f"{diameter:9g}{noise:8g}{row['std_mm']:9.4f}{row['std_mm'] / noise:8.2f}"
                f"{row['diameter_bias_mm']:+11.4f}{row['width_mm']:8.3f}", flush=True,
            )  # fmt: skip
    if options.write:
        config = {"order": options.order, "points": POINTS}
        record.write(RESULT, {"rows": record.table(rows, config=config)}, seeds=[7], config=config)


if __name__ == "__main__":
    main()
