"""Beams and clouds a second: our traced cables against Open3D's raycaster on the same beams, in the same run.

python -m benchmarks.simulate [--rounds 5]

Casting alone is compared: the same 100,000 beams from a travelling head at a bent cable, once met by `cast`, once by
Open3D's `RaycastingScene` on a mesh of it that is fine enough to be as exact (a chord error of 1e-4 mm). The mesh's
building is timed apart, since a training set needs one mesh a cloud. Times are medians after a warm-up.
"""

import argparse
import ctypes
import statistics
import time
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from cablejax.simulate import DatasetConfig, bare, make_tube, sample_clouds
from cablejax.simulate.beams import aim, cast
from tests.reference.simulate import centreline, mesh

RADIUS_MM, LENGTH_MM, BEND_MM, BEAMS = 17.1, 200.0, 700.0, 100_000


def seconds(work: Callable[[], object], rounds: int) -> float:
    """Median time of a call after one to warm up."""
    jax.block_until_ready(work())
    times = []
    for _ in range(rounds):
        start = time.perf_counter()
        jax.block_until_ready(work())
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def load_open3d():
    """Open3D, with the libusb that its wheel needs and a bare machine lacks."""
    import libusb_package

    ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)
    import open3d

    return open3d


def casting(rounds: int) -> None:
    """Beams a second, ours and Open3D's."""
    open3d = load_open3d()
    tube = make_tube("bend", diameter_mm=2 * RADIUS_MM, length_mm=LENGTH_MM, bend_radius_mm=BEND_MM)
    rng = np.random.default_rng(0)
    arc, across, angle = rng.uniform(size=(3, BEAMS)) * np.array([[LENGTH_MM], [2.0], [2 * np.pi]])
    place = [jnp.asarray(x, jnp.float32) for x in (arc, arc, across - 1, angle)]
    beams = jax.jit(jax.vmap(aim, in_axes=(None, 0, 0, 0, 0, None, None)))(tube, *place, 250.0, 0.5)
    ours = jax.jit(jax.vmap(cast, in_axes=(None, 0)))
    scene_jax = bare(tube)
    mine = seconds(lambda: ours(scene_jax, beams), rounds)

    def build():
        shape = centreline("bend", length=LENGTH_MM, bend_radius=BEND_MM, step=0.5)
        vertices, triangles = mesh(*shape, lambda arc, angle: RADIUS_MM + 0 * arc * angle, turns=900)
        scene = open3d.t.geometry.RaycastingScene()
        scene.add_triangles(
            open3d.core.Tensor(vertices.astype(np.float32)), open3d.core.Tensor(triangles.astype(np.uint32))
        )
        scene.cast_rays(open3d.core.Tensor(np.zeros((1, 6), np.float32)))  # builds the tree
        return scene

    start = time.perf_counter()
    scene = build()
    building = time.perf_counter() - start
    rays = open3d.core.Tensor(np.concatenate([beams.origin_mm, beams.direction], axis=1))
    theirs = seconds(lambda: scene.cast_rays(rays)["t_hit"].numpy(), rounds)
    echo, found = ours(scene_jax, beams), scene.cast_rays(rays)["t_hit"].numpy()
    both = np.asarray(echo.hit) & np.isfinite(found)
    gap = np.abs(np.asarray(echo.range_mm) - found)[both] * np.asarray(echo.cosine)[both]
    print(f"device {jax.devices()[0].device_kind}; {BEAMS:,} beams, both hit {both.mean():.1%}, "
          f"largest difference along the normal {gap.max():.1e} mm")  # fmt: skip
    print(f"cablejax      {BEAMS / mine:12,.0f} beams/s")
    print(f"Open3D        {BEAMS / theirs:12,.0f} beams/s, after {building:.2f} s for its mesh and tree")
    print(f"Open3D / ours {mine / theirs:12.2f} casting alone; ours / Open3D with the mesh "
          f"{(theirs + building) / mine:.1f}")  # fmt: skip


def clouds(rounds: int) -> None:
    """Training clouds a minute, everything included: beams, noise, outliers, pose."""
    for version in ("clean", "standard", "hard", "real-like"):
        for n_points in (256, 1024):
            config = DatasetConfig(version=version, n_points=n_points)
            taken = seconds(lambda c=config: sample_clouds(c, 64, key=jax.random.key(0)), rounds)
            print(f"{version:10s} {n_points:5d} points {60 * 64 / taken:10,.0f} clouds/min")


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5)
    rounds = parser.parse_args().rounds
    casting(rounds)
    clouds(rounds)


if __name__ == "__main__":
    main()
