"""Beams and training clouds a second: our traced cables against Open3D's raycaster, in the same run.

    python -m benchmarks.simulate [--rounds 5] [--output results/benchmarks/simulate.json]

Three tables. Casting: the same 100,000 beams from a travelling head at one bent cable, met by `cast` and by Open3D's
`RaycastingScene` on a mesh of it, fine (within 3e-4 mm of the cable) and coarse (within 0.03 mm). Clouds: 64
different cables with 2,048 beams each, as a training batch needs them; Open3D gets a mesh and a tree for every cable.
Training clouds: everything included, beams, noise, outliers, clutter, pose. Contenders take turns.
"""

import argparse
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks import record
from benchmarks.timing import alternate, open3d_module
from cablejax.simulate import DatasetConfig, bare, make_tube, sample_clouds
from cablejax.simulate.beams import Beam, aim, cast
from cablejax.simulate.clouds import VERSIONS
from tests.reference.simulate import centreline, mesh

RADIUS_MM, LENGTH_MM, BEND_MM, BEAMS = 17.1, 200.0, 700.0, 100_000
CLOUDS, CLOUD_BEAMS = 64, 2048
MESHES = {"fine": (0.5, 900), "coarse": (5.0, 96)}  # step along in mm and turns
aim_many = jax.vmap(aim, in_axes=(None, 0, 0, 0, 0, None, None))


def rays_at(tube: Any, beams: int, seed: int) -> Beam:
    """Beams from a travelling head, all round, over the whole view."""
    rng = np.random.default_rng(seed)
    arc, across, angle = rng.uniform(size=(3, beams)) * np.array([[LENGTH_MM], [2.0], [2 * np.pi]])
    place = [jnp.asarray(x, jnp.float32) for x in (arc, arc, across - 1, angle)]
    return jax.jit(aim_many)(tube, *place, 250.0, 0.5)


def as_open3d(open3d: Any, beams: Beam) -> Any:
    """The beams as Open3D's rays."""
    return open3d.core.Tensor(np.concatenate([beams.origin_mm, beams.direction], axis=1))


def raycaster(open3d: Any, bend_mm: float, radius_mm: float, exactness: str) -> Any:
    """Open3D's scene of a bent cable, its tree built."""
    step, turns = MESHES[exactness]
    line = centreline("bend", length=LENGTH_MM, bend_radius=bend_mm, step=step)
    vertices, triangles = mesh(*line, lambda arc, angle: radius_mm + 0 * arc * angle, turns=turns)
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        open3d.core.Tensor(vertices.astype(np.float32)), open3d.core.Tensor(triangles.astype(np.uint32))
    )
    scene.cast_rays(open3d.core.Tensor(np.zeros((1, 6), np.float32)))
    return scene


def raced(title: str, runs: Mapping[str, Callable[[], Any]], config: Mapping[str, Any]) -> dict[str, Any]:
    """`alternate` with the time of each contender's first call taken here."""
    first = {}
    for name, run in runs.items():
        start = time.perf_counter()
        run()
        first[name] = time.perf_counter() - start
    return alternate(title, runs, first, config, None)


def casting(open3d: Any, rounds: int) -> dict[str, Any]:
    """100,000 beams at one cable."""
    tube = make_tube("bend", diameter_mm=2 * RADIUS_MM, length_mm=LENGTH_MM, bend_radius_mm=BEND_MM)
    scene, beams, ours = bare(tube), rays_at(tube, BEAMS, 0), jax.jit(jax.vmap(cast, in_axes=(None, 0)))
    rays = as_open3d(open3d, beams)
    theirs = {name: raycaster(open3d, BEND_MM, RADIUS_MM, name) for name in MESHES}
    runs: dict[str, Callable[[], Any]] = {"cablejax": lambda: jax.block_until_ready(ours(scene, beams))}
    for name, caster in theirs.items():
        runs[f"open3d {name}"] = lambda caster=caster: caster.cast_rays(rays)["t_hit"].numpy()
    result = raced("casting", runs, {"beams": BEAMS, "rounds": rounds})
    echo = ours(scene, beams)
    for name, caster in theirs.items():
        found = caster.cast_rays(rays)["t_hit"].numpy()
        both = np.asarray(echo.hit) & np.isfinite(found)
        gap = np.abs(np.asarray(echo.range_mm) - found)[both] * np.asarray(echo.cosine)[both]
        row = next(row for row in result["rows"] if row["contender"] == f"open3d {name}")
        row |= {"largest_difference_mm": float(gap.max()), "both_hit": float(both.mean())}
        print(f"{name}: both hit {both.mean():.1%}, largest difference along the normal {gap.max():.1e} mm")
    return result


def batch(open3d: Any, rounds: int) -> dict[str, Any]:
    """Noise-free clouds of 64 different cables."""
    bends, radii = np.linspace(700, 3000, CLOUDS), np.linspace(10.6, 22.8, CLOUDS)
    tubes = [
        make_tube("bend", diameter_mm=2 * r, length_mm=LENGTH_MM, bend_radius_mm=b)
        for b, r in zip(bends, radii, strict=True)
    ]
    beams = [rays_at(tube, CLOUD_BEAMS, seed) for seed, tube in enumerate(tubes)]
    scenes, stacked = (jax.tree.map(lambda *x: jnp.stack(x), *items) for items in ([bare(t) for t in tubes], beams))
    rays = [as_open3d(open3d, beam) for beam in beams]
    ours = jax.jit(jax.vmap(jax.vmap(cast, in_axes=(None, 0))))

    def theirs(exactness: str) -> None:
        for bend, radius, ray in zip(bends, radii, rays, strict=True):
            raycaster(open3d, bend, radius, exactness).cast_rays(ray)["t_hit"].numpy()

    runs = {"cablejax": lambda: jax.block_until_ready(ours(scenes, stacked)), "open3d coarse": lambda: theirs("coarse")}
    result = raced("clouds of noise-free points", runs, {"clouds": CLOUDS, "beams_each": CLOUD_BEAMS, "rounds": rounds})
    for row in result["rows"]:
        row["clouds_per_second"] = CLOUDS / row["median_s"]
    return result


def training_clouds(rounds: int) -> list[dict[str, Any]]:
    """Training clouds a minute, by version and size."""
    rows = []
    for version in VERSIONS:
        for n_points in (256, 1024):
            config = DatasetConfig(version=version, n_points=n_points)
            times = []
            for seed in range(rounds + 1):
                start = time.perf_counter()
                jax.block_until_ready(sample_clouds(config, CLOUDS, key=jax.random.key(seed)))
                times.append(time.perf_counter() - start)
            rate = 60 * CLOUDS / float(np.median(times[1:]))
            rows.append({"version": version, "points": n_points, "clouds_per_minute": rate, "first_call_s": times[0]})
            print(
                f"{version:10s} {n_points:5d} points {rate:10,.0f} clouds/min, first call {times[0]:.1f} s", flush=True
            )
    return rows


def main() -> None:
    """Print the tables and write them with their provenance."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--output", type=Path, default=Path("results/benchmarks/simulate.json"))
    options = parser.parse_args()
    open3d, rounds = open3d_module(), options.rounds
    device = jax.devices()[0].device_kind
    print(f"device {device}")
    found = {
        "casting": casting(open3d, rounds),
        "batch": batch(open3d, rounds),
        "training_clouds": record.table(training_clouds(rounds), config={"device": device}),
    }
    record.write(options.output, found, seeds=[0], config={"rounds": rounds})


if __name__ == "__main__":
    main()
