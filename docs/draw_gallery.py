"""Draw the pictures of docs/simulate.md: every scene, preset, finish and version of the dataset.

    python docs/draw_gallery.py [shapes presets finishes dataset]

Writes docs/images/*.png. Seeds are fixed, so the same revision draws the same pictures.
"""

import io
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

import jax
import matplotlib as mpl
import matplotlib.colors as mpl_colors
import numpy as np

mpl.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from cablejax.simulate import (
    FINISHES,
    PRESETS,
    SCENES,
    DatasetConfig,
    Part,
    Scan,
    catalogue,
    make_scene,
    make_split,
    make_tube,
    signed_distance,
    simulate_scan,
)  # fmt: skip
from cablejax.simulate.clouds import VERSIONS
from cablejax.simulate.scenes import SHEATHS

IMAGES = Path(__file__).parent / "images"
COMBINED = ("bend+ribbed", "bend+joint", "s-bend+clamp", "bend+trefoil", "s-bend+tray")
CABLE = next(cable for cable in catalogue() if cable.size_mm2 == 240)
COLORS = {
    Part.CABLE: "#3b6ea5", Part.AIR: "#c43c39", Part.JOINT: "#e0812c", Part.STRESS_CONE: "#e0812c",
    Part.TERMINATION: "#e0812c", Part.CLAMP: "#8a5a9e", Part.SADDLE: "#8a5a9e", Part.BRACKET: "#6b6b6b",
    Part.WALL: "#b9ae98", Part.TRAY: "#8d979e", Part.OTHER_CABLE: "#4f9b8f",
}  # fmt: skip
VIEW = np.array([-0.35, -0.75, 0.56])  # towards the eye


def project(xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Right, up and depth of points seen from `VIEW`, parallel."""
    toward = VIEW / np.linalg.norm(VIEW)
    right = np.cross([0, 0, 1.0], toward)
    right /= np.linalg.norm(right)
    return xyz @ right, xyz @ np.cross(toward, right), xyz @ toward


def draw_points(axes: Axes, xyz: np.ndarray, colors: np.ndarray, normals: np.ndarray, *, size: float) -> None:
    """Points from behind to the front, those that face away left out, shaded by Lambert's law."""
    toward = VIEW / np.linalg.norm(VIEW)
    facing = normals @ toward
    right, up, depth = project(xyz)
    light = np.array([-0.2, -0.45, 0.87])
    shade = 0.35 + 0.65 * np.clip(normals @ light, 0, 1)
    shown = np.flatnonzero(facing > -0.05)
    order = shown[np.argsort(depth[shown])]
    axes.scatter(right[order], up[order], s=size, c=np.clip(colors[order] * shade[order, None], 0, 1), linewidths=0)
    axes.set_aspect("equal")
    axes.axis("off")


def draw_scene(axes: Axes, name: str, seed: int) -> None:
    """One scene as the ideal scanner sees it; sheaths coloured by how far they are from the round tube."""
    key = jax.random.key(seed)
    scan = simulate_scan(CABLE, n_points=12_000, preset="ideal", shape=name, outlier_fraction=0.0, key=key)
    scene = make_scene(name, diameter_mm=CABLE.diameter_mm, length_mm=400.0)
    normals = np.asarray(jax.jit(jax.vmap(scene.locate))(scan.xyz_mm).normal)
    part = np.asarray(scan.part)
    colors = np.array([mpl_colors.to_rgb(COLORS[int(label)]) for label in part])
    title = name
    if set(name.split("+")) & set(SHEATHS):
        line = name.split("+")[0] if "+" in name else "straight"
        tube = make_tube(line, diameter_mm=CABLE.diameter_mm, length_mm=400.0)
        off = np.asarray(signed_distance(tube, scan.xyz_mm))
        reach = np.abs(off).max()
        colors = mpl.colormaps["coolwarm"](0.5 + 0.5 * off / reach)[:, :3]
        title = f"{name} (±{reach:.2f} mm)"
    draw_points(axes, np.asarray(scan.xyz_mm), colors, normals, size=1.1)
    axes.set_title(title, fontsize=8, pad=2)


def shapes() -> Figure:
    """All scenes, and some combined ones."""
    names = (*SCENES, *COMBINED)
    figure, axes = plt.subplots(6, 4, figsize=(10, 7.4), constrained_layout=True)
    for seed, (place, name) in enumerate(zip(axes.flat, names, strict=True)):
        draw_scene(place, name, seed)
    return figure


def section(scan: Scan) -> tuple[np.ndarray, np.ndarray]:
    """Points of a slice 20 mm wide about the middle, and their rows."""
    xyz = np.asarray(scan.xyz_mm)
    rows = np.flatnonzero((np.abs(xyz[:, 0]) < 10) & (np.asarray(scan.part) != Part.AIR))
    return xyz[rows], rows


def presets() -> Figure:
    """A section of the same cable by every scanner, and the deviation around it."""
    figure, axes = plt.subplots(2, len(PRESETS), figsize=(13, 5.4), constrained_layout=True)
    for column, name in enumerate(PRESETS):
        scan = simulate_scan(CABLE, n_points=20_000, preset=name, key=jax.random.key(7))
        xyz, rows = section(scan)
        mixed, radius = np.asarray(scan.is_mixed)[rows], 0.5 * CABLE.diameter_mm
        top, bottom = axes[:, column]
        turn = np.linspace(0, 2 * np.pi, 400)
        top.plot(radius * np.cos(turn), radius * np.sin(turn), color="0.6", lw=0.8)
        for flag, color in ((False, "#3b6ea5"), (True, "#c43c39")):
            top.scatter(*xyz[mixed == flag, 1:].T, s=2, c=color, linewidths=0)
        top.set(xlim=(-24, 24), ylim=(-24, 24), aspect="equal", title=name)
        top.tick_params(labelsize=7)
        angle = np.degrees(np.arctan2(xyz[:, 2], xyz[:, 1]))
        distance = np.asarray(scan.signed_distance_mm)[rows]
        for flag, color in ((False, "#3b6ea5"), (True, "#c43c39")):
            bottom.scatter(angle[mixed == flag], distance[mixed == flag], s=2, c=color, linewidths=0)
        bottom.set(xlim=(-180, 180), ylim=(-6, 6) if name == "terrestrial" else (-1.5, 1.5), xticks=(-180, 0, 180))
        bottom.set_title(f"std {distance[~mixed].std():.3f} mm", fontsize=8)
        bottom.set_xlabel("angle, degrees", fontsize=8)
        bottom.tick_params(labelsize=7)
    axes[0, 0].set_ylabel("section, mm", fontsize=8)
    axes[1, 0].set_ylabel("deviation from the surface, mm", fontsize=8)
    return figure


def finishes() -> Figure:
    """The sheath unrolled, as one station of the line laser gets it back from each finish."""
    figure, axes = plt.subplots(1, len(FINISHES), figsize=(12, 3.4), constrained_layout=True, sharey=True)
    for place, name in zip(axes, FINISHES, strict=True):
        scan = simulate_scan(
            CABLE, n_points=6000, stations=1, arc_deg=180.0, length_mm=200.0, outlier_fraction=0.0, finish=name,
            key=jax.random.key(3),
        )  # fmt: skip
        xyz = np.asarray(scan.xyz_mm)
        angle = np.degrees(np.arctan2(xyz[:, 2], xyz[:, 1])) - 90
        place.scatter(angle, xyz[:, 0], s=1.2, c="#3b6ea5", linewidths=0)
        place.set(title=name, xlim=(-90, 90), xlabel="degrees from the scanner", xticks=(-90, -45, 0, 45, 90))
    axes[0].set_ylabel("mm along the cable")
    return figure


def dataset() -> Figure:
    """Training clouds of every version."""
    figure, axes = plt.subplots(len(VERSIONS), 6, figsize=(11, 4.6), constrained_layout=True)
    for row, version in zip(axes, VERSIONS, strict=True):
        config = DatasetConfig(version=version, clouds_per_class=1, seed=5)
        split = make_split(config, "train")
        for place, xyz, mask, label in zip(row, split.xyz, split.mask, split.label, strict=True):
            points = np.asarray(xyz)[np.asarray(mask)]
            right, up, depth = project(points)
            place.scatter(right, up, s=1.5, c=depth, cmap="viridis", linewidths=0)
            place.set(aspect="equal", xlim=(-150, 150), ylim=(-75, 75), xticks=(), yticks=())
            place.set_title(f"{config.sizes_mm2[int(label)]} mm², {mask.sum()} points", fontsize=7, pad=2)
        row[0].set_ylabel(version, fontsize=9)
    return figure


PICTURES: dict[str, Callable[[], Figure]] = {
    "shapes": shapes, "presets": presets, "finishes": finishes, "dataset": dataset,
}  # fmt: skip


def main(names: Iterable[str]) -> None:
    """Draw the pictures named, or all."""
    IMAGES.mkdir(exist_ok=True)
    for name in tuple(names) or tuple(PICTURES):
        path = IMAGES / f"{name}.png"
        figure = PICTURES[name]()
        page = io.BytesIO()
        figure.savefig(page, dpi=100)
        plt.close(figure)
        Image.open(page).convert("RGB").quantize(64).save(path, optimize=True)  # thousands of dots make large files
        sys.stdout.write(f"{path.name}: {path.stat().st_size:,} bytes\n")


if __name__ == "__main__":
    main(sys.argv[1:])
