"""Clouds whose points are labelled by part: scenes drawn at random, scanned, and cut into balls.

A network that labels points sees a ball at a time, so that it serves scans of any extent.
"""

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from tqdm import tqdm

from cablejax.simulate.accessories import Revolved, revolve, with_clamp, with_joint, with_stress_cone, with_termination
from cablejax.simulate.clutter import FLAT_MM, Neighbour, Plane, Scene, box, neighbour, support, tray
from cablejax.simulate.nominal import catalogue
from cablejax.simulate.pose import centred, rotation_of
from cablejax.simulate.presets import PRESETS, numbers_of
from cablejax.simulate.shapes import Tube, straight_run, two_bends
from cablejax.simulate.surface import Part, label
from cablejax.simulate.sweeps import hang_in_air, sweep_beams

PARTS = ("cable", "stray", "accessory", "fitting", "surroundings")
GROUP = np.zeros(len(Part), np.int32)  # of each `Part`, its place in PARTS; another cable is a cable
GROUP[Part.AIR] = 1
GROUP[[Part.JOINT, Part.STRESS_CONE, Part.TERMINATION]] = 2
GROUP[[Part.CLAMP, Part.SADDLE, Part.BRACKET]] = 3
GROUP[[Part.WALL, Part.TRAY]] = 4

SPLITS = ("train", "validation", "test")
SCANNERS = ("line-laser", "structured-light", "paper-floor", "terrestrial")
ACCESSORIES = (None, "joint", "joint-stepped", "stress-cone", "termination", "clamp")
SURROUNDINGS = (None, "wall", "tray", "support", "trefoil")
CORNERS = 20  # of the longest accessory, four rain sheds; all scenes have as many, and share one compiled program
LINES, COLUMNS, STATIONS = 96, 48, 3
MOST_STRAY = 0.08  # of the points
CHUNK = 16  # clouds a compiled call


@dataclass(frozen=True)
class PartsConfig:
    """What the labelled clouds are like.

    Attributes:
        n_points: Points a cloud; balls that hold fewer are padded.
        ball_mm: Radius of the ball that is cut out of a scan.
        seed: Root of every random draw.
    """

    n_points: int = 1024
    ball_mm: float = 250.0
    seed: int = 0

    def __post_init__(self) -> None:
        if self.n_points < 64:
            raise ValueError(f"n_points: expected at least 64, got {self.n_points!r}")
        if not self.ball_mm > 0:
            raise ValueError(f"ball_mm: expected a number above 0, got {self.ball_mm!r}")


class PartSplit(NamedTuple):
    """Labelled clouds.

    Attributes:
        xyz: Points in mm, centred on their mean, at a random rotation `[clouds, n, 3]`.
        mask: True where a row is a point `[clouds, n]`.
        label: Index into `PARTS` of each point `[clouds, n]`; 0 on padding.
    """

    xyz: Float[Array, "clouds n 3"]
    mask: Bool[Array, "clouds n"]
    label: Int[Array, "clouds n"]


class _Drawn(NamedTuple):
    """One scene with the way it is scanned: arrays alone, so that many are stacked."""

    scene: Scene
    numbers: dict[str, Array]
    middle: Array
    arc: Array
    stray: Array
    on_cable: Array


def _padded(cable: Revolved) -> Revolved:
    """The same surface with `CORNERS` corners: the last one again and again, a millimetre apart."""
    more = CORNERS - len(cable.arc_mm)
    arc = np.concatenate([cable.arc_mm, float(cable.arc_mm[-1]) + 1.0 + np.arange(more)])
    rho = np.concatenate([cable.rho_mm, np.full(more, cable.rho_mm[-1])])
    parts = np.concatenate([cable.parts, np.full(more, cable.parts[-1])])
    return cable._replace(arc_mm=arc.astype(np.float32), rho_mm=rho.astype(np.float32), parts=parts.astype(np.int32))


def _dressed(tube: Tube, accessory: str | None, rng: np.random.Generator) -> Revolved:
    """The cable with an accessory of random size."""
    r, length = float(tube.radius_mm), float(tube.length_mm)
    wide, long = r * rng.uniform(1.4, 2.2), length * rng.uniform(0.25, 0.5)
    if accessory == "joint":
        return with_joint(tube, radius_mm=wide, length_mm=long, taper_mm=rng.uniform(5.0, 25.0))
    if accessory == "joint-stepped":
        return with_joint(tube, radius_mm=wide, length_mm=long, taper_mm=0.0)
    if accessory == "stress-cone":
        return with_stress_cone(tube, radius_mm=wide, length_mm=long)
    if accessory == "termination":
        return with_termination(tube, core_mm=r * rng.uniform(0.55, 0.8), shed_mm=wide)
    if accessory == "clamp":
        return with_clamp(tube, thickness_mm=rng.uniform(2.0, 10.0), width_mm=rng.uniform(15.0, 50.0))
    middle = 0.5 * length
    return revolve(tube, [(middle - 1, r), (middle + 1, r)], [Part.CABLE])


def _solids(cable: Revolved, tube: Tube, around: str | None, rng: np.random.Generator) -> tuple:
    """Wall, tray, saddle, bracket and two more cables; what is not there stands far away."""
    r, outline = float(cable.radius_mm), float(cable.outline_mm)
    tilt, gap = rng.uniform(-0.3, 0.3), rng.uniform(1.0, 60.0)
    there = around == "wall"
    normal = jnp.asarray([0.0, np.sin(tilt), np.cos(tilt)], jnp.float32)
    plane = Plane(normal, jnp.float32(-(outline + gap) if there else -FLAT_MM), label(Part.WALL))
    nowhere = [box((0.0, 0.0, -FLAT_MM), (1.0, 1.0, 1.0), part) for part in (Part.TRAY, Part.SADDLE)]
    sheets = [nowhere[0]] * 3
    if around == "tray":
        sheets = list(tray(cable, height_mm=rng.uniform(25.0, 80.0)).solids)
    held = list(support(cable).solids) if around == "support" else [nowhere[1]] * 2
    offsets = [(r, -(3**0.5) * r), (-r, -(3**0.5) * r)] if around == "trefoil" else []
    if not offsets and rng.uniform() < 0.25:
        offsets = [(rng.choice([-1.0, 1.0]) * (2 * outline + rng.uniform(0.5, 30.0)), rng.uniform(-0.5, 0.5) * r)]
    others: list[Neighbour] = [
        neighbour(tube, jnp.float32(across), jnp.float32(up), jnp.float32(r)) for across, up in offsets
    ]
    far = neighbour(tube, jnp.float32(0.0), jnp.float32(FLAT_MM), jnp.float32(r))
    return (plane, *sheets, *held, *others, *[far] * (2 - len(others)))


def _draw_scene(config: PartsConfig, split: int, index: int) -> _Drawn:
    """A scene: any diameter around the catalogue's, bends from 10 D, a dressing, surroundings, a scanner, a view."""
    rng = np.random.default_rng((config.seed, split, index))
    sizes = [cable.diameter_mm for cable in catalogue()]
    diameter = rng.uniform(0.8 * min(sizes), 1.2 * max(sizes))
    length = rng.uniform(250.0, 550.0)
    bends = rng.uniform(-1.0, 1.0, 2) / (10 * diameter)
    accessory = ACCESSORIES[rng.choice(len(ACCESSORIES), p=[0.45, 0.12, 0.08, 0.1, 0.13, 0.12])]
    around = SURROUNDINGS[rng.choice(len(SURROUNDINGS), p=[0.3, 0.2, 0.25, 0.15, 0.1])]
    tube = two_bends(jnp.float32(diameter / 2), jnp.float32(length), jnp.float32(bends[0]), jnp.float32(bends[1]), 0.4)
    low, high = (0.4, 2.0) if accessory == "termination" else (0.2, 0.8)
    tube = straight_run(tube, low * length, high * length)
    cable = _dressed(tube, accessory, rng)
    solids = _solids(cable, tube, around, rng)
    view = rng.uniform(5.0, 100.0)
    device = PRESETS[SCANNERS[rng.choice(len(SCANNERS))]]
    middle, arc, stray = np.pi / 2 + rng.uniform(-0.7, 0.7), np.radians(rng.uniform(60.0, 360.0)), rng.uniform(0.0, 1.0)
    return _Drawn(
        Scene(_padded(cable), solids, jnp.float32(view)),
        numbers_of(device),
        jnp.float32(middle),
        jnp.float32(arc),
        jnp.float32(MOST_STRAY * stray),
        jnp.asarray(rng.uniform() < 0.75),
    )


@partial(jax.jit, static_argnames=("n_points",))
def _balls(drawn: _Drawn, keys: Array, ball_mm: Array, *, n_points: int):
    return jax.vmap(partial(_ball, n_points=n_points), in_axes=(0, 0, None))(drawn, keys, ball_mm)


def _ball(drawn: _Drawn, key: Array, ball_mm: Array, *, n_points: int) -> tuple[Array, Array, Array]:
    """Scan, choose a point, and keep what lies about it: `[n, 3]`, mask and labels `[n]`."""
    keys = jax.random.split(key, 4)
    angles = drawn.middle + drawn.arc * ((jnp.arange(STATIONS) + 0.5) / STATIONS - 0.5)
    back = sweep_beams(
        drawn.scene, angles, drawn.arc, drawn.middle, drawn.numbers, keys[0], lines=LINES, columns=COLUMNS
    )
    beams = back.valid.shape[0]
    spare = int(MOST_STRAY * beams)
    air = hang_in_air(drawn.scene.cable, keys[1], count=spare)
    strays = jnp.arange(spare) < drawn.stray * jnp.sum(back.valid)
    xyz = jnp.concatenate([back.xyz_mm, air])
    valid = jnp.concatenate([back.valid, strays])
    part = jnp.concatenate([back.part, jnp.full(spare, Part.AIR)])
    luck = jax.random.uniform(keys[2], (2, beams + spare))
    wanted = valid & (~drawn.on_cable | (part == Part.CABLE))
    center = xyz[jnp.argmax(jnp.where(wanted, luck[0], -1.0))]
    near = valid & (jnp.sum((xyz - center[None, :]) ** 2, axis=1) < ball_mm**2)
    rows = jax.lax.top_k(jnp.where(near, luck[1], -1.0), n_points)[1]
    mask = near[rows]
    points = jnp.where(
        mask[:, None], xyz[rows], 0.0
    )  # a beam that met nothing may be NaN, which no weight of 0 takes away
    turned = centred(points, mask) @ rotation_of(jax.random.normal(keys[3], (4,))).T
    return turned, mask, jnp.where(mask, jnp.asarray(GROUP)[part[rows]], 0)


def make_part_split(config: PartsConfig, split: str, clouds: int, *, progress: bool = False) -> PartSplit:
    """Labelled balls out of simulated scans, one from each: the same bytes for the same configuration.

    Scenes hold one to three cables, bare or with a joint, stress cone, termination or clamp, alone or before a wall, in a
    tray or on a saddle, seen by one of `SCANNERS` over 60 to 360 degrees, with up to 8 % of stray points.

    Args:
        config: What the clouds are like.
        split: "train", "validation" or "test"; each has random streams of its own.
        clouds: How many.
        progress: Show a bar where the output is a terminal.

    Raises:
        ValueError: If `split` is unknown or `clouds` below 1.
    """
    if split not in SPLITS:
        raise ValueError(f"split: expected one of {', '.join(SPLITS)}, got {split!r}")
    if clouds < 1:
        raise ValueError(f"clouds: expected at least 1, got {clouds!r}")
    number = SPLITS.index(split)
    root = jax.random.fold_in(jax.random.key(config.seed), number)
    found = []
    for start in tqdm(range(0, clouds, CHUNK), f"{split} scans", disable=None if progress else True):
        index = np.arange(start, start + CHUNK)
        drawn = [jax.tree.map(np.asarray, _draw_scene(config, number, int(i))) for i in index]
        keys = jax.vmap(jax.random.fold_in, in_axes=(None, 0))(root, jnp.asarray(index))
        stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *drawn)
        found.append(jax.device_get(_balls(stacked, keys, jnp.float32(config.ball_mm), n_points=config.n_points)))
    return PartSplit(*(jnp.asarray(np.concatenate(each)[:clouds]) for each in zip(*found, strict=True)))
