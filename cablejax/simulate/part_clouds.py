"""Clouds whose points are labelled by part: scenes drawn at random, scanned, and cut into balls.

A network that labels points sees a ball at a time, so that it serves scans of any extent.
"""

from dataclasses import dataclass
from functools import partial
from itertools import count
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from tqdm import tqdm

from cablejax.simulate.part_scenes import MOST_STRAY, Drawn, draw_scene
from cablejax.simulate.pose import centred, rotation_of
from cablejax.simulate.surface import Part
from cablejax.simulate.sweeps import hang_in_air, sweep_beams

PARTS = ("cable", "stray", "accessory", "fitting", "surroundings")
GROUP = np.zeros(len(Part), np.int32)  # of each `Part`, its place in PARTS; another cable is a cable
GROUP[Part.AIR] = 1
GROUP[[Part.JOINT, Part.STRESS_CONE, Part.TERMINATION]] = 2
GROUP[[Part.CLAMP, Part.SADDLE, Part.BRACKET]] = 3
GROUP[[Part.WALL, Part.TRAY]] = 4

SPLITS = ("train", "validation", "test")
RASTER = {"cables": (96, 48), "wide": (64, 40)}  # lines and columns of each station, by mix
MIXES = tuple(RASTER)
STATIONS = 3
LEAST_POINTS = 20  # of a cloud: a pole may stand before the scanner, and such a scene is passed over
LEAST_LEFT = 200  # returns of other things, without which a cable is not taken out of its scan
CHUNK = 16  # clouds a compiled call


@dataclass(frozen=True)
class PartsConfig:
    """What the labelled clouds are like.

    Attributes:
        n_points: Points a cloud; balls that hold fewer are padded.
        ball_mm: Radius of the ball that is cut out of a scan.
        mix: "cables", or "wide": more sizes, scanners and drop-out, and boxes, bottles, poles and stems beside the cable.
        seed: Root of every random draw.
    """

    n_points: int = 1024
    ball_mm: float = 250.0
    mix: str = "cables"
    seed: int = 0

    def __post_init__(self) -> None:
        if self.n_points < 64:
            raise ValueError(f"n_points: expected at least 64, got {self.n_points!r}")
        if not self.ball_mm > 0:
            raise ValueError(f"ball_mm: expected a number above 0, got {self.ball_mm!r}")
        if self.mix not in MIXES:
            raise ValueError(f"mix: expected one of {', '.join(MIXES)}, got {self.mix!r}")


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


@partial(jax.jit, static_argnames=("n_points", "raster"))
def _balls(drawn: Drawn, keys: Array, ball_mm: Array, *, n_points: int, raster: tuple[int, int]):
    return jax.vmap(partial(_ball, n_points=n_points, raster=raster), in_axes=(0, 0, None))(drawn, keys, ball_mm)


def _ball(
    drawn: Drawn, key: Array, ball_mm: Array, *, n_points: int, raster: tuple[int, int]
) -> tuple[Array, Array, Array]:
    """Scan, choose a point, and keep what lies about it: `[n, 3]`, mask and labels `[n]`."""
    keys = jax.random.split(key, 4)
    angles = drawn.middle + drawn.arc * ((jnp.arange(STATIONS) + 0.5) / STATIONS - 0.5)
    back = sweep_beams(
        drawn.scene, angles, drawn.arc, drawn.middle, drawn.numbers, keys[0], lines=raster[0], columns=raster[1]
    )
    beams = back.valid.shape[0]
    spare = int(MOST_STRAY * beams)
    air = hang_in_air(drawn.scene.cable, keys[1], count=spare)
    strays = jnp.arange(spare) < drawn.stray * jnp.sum(back.valid)
    xyz = jnp.concatenate([back.xyz_mm, air])
    valid = jnp.concatenate([back.valid, strays])
    part = jnp.concatenate([back.part, jnp.full(spare, Part.AIR)])
    valid &= ~_taken_out(drawn, xyz, part, valid, jax.random.fold_in(key, 4))
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


def _drawn(config: PartsConfig, split: int, index: int) -> Drawn:
    scene = draw_scene(np.random.default_rng((config.seed, split, index)), wide=config.mix == "wide")
    return jax.tree.map(np.asarray, scene)


def _taken_out(drawn: Drawn, xyz: Array, part: Array, valid: Array, key: Array) -> Bool[Array, " m"]:
    """Points of a cable that is left out, where enough else is seen, and of a hole about any point of the scan."""
    own = jnp.isin(jnp.asarray(GROUP)[part], jnp.array([0, 2, 3])) & (part != Part.OTHER_CABLE)
    gone = own & drawn.gone & (jnp.sum(valid & ~own & (part != Part.AIR)) >= LEAST_LEFT)
    middle = xyz[jnp.argmax(jnp.where(valid & ~gone, jax.random.uniform(key, part.shape), -1.0))]
    return gone | (jnp.sum((xyz - middle[None, :]) ** 2, axis=1) < drawn.hole_mm**2)


def make_part_split(config: PartsConfig, split: str, clouds: int, *, progress: bool = False) -> PartSplit:
    """Labelled balls out of simulated scans, one from each: the same bytes for the same configuration.

    Scenes hold one to three cables, bare or with a joint, stress cone, termination or clamp, alone or before a wall, in a
    tray or on a saddle, seen by one of four scanners over 60 to 360 degrees, with up to 8 % of stray points. In the wide mix
    boxes, bottles, cans, poles or stems stand beside, another cable may cross, and some scans have lost their cable.

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
    found: list[tuple[np.ndarray, ...]] = []
    bar = tqdm(total=clouds, desc=f"{split} scans", disable=None if progress else True)
    for start in count(0, CHUNK):
        index = np.arange(start, start + CHUNK)
        drawn = [_drawn(config, number, int(i)) for i in index]
        keys = jax.vmap(jax.random.fold_in, in_axes=(None, 0))(root, jnp.asarray(index))
        stacked = jax.tree.map(lambda *leaves: np.stack(leaves), *drawn)
        ball_mm, raster = jnp.float32(config.ball_mm), RASTER[config.mix]
        chunk = jax.device_get(_balls(stacked, keys, ball_mm, n_points=config.n_points, raster=raster))
        rows = chunk[1].sum(axis=1) >= LEAST_POINTS
        found.append(tuple(each[rows] for each in chunk))
        bar.update(int(rows.sum()))
        if sum(len(mask) for _, mask, _ in found) >= clouds:
            break
    bar.close()
    return PartSplit(*(jnp.asarray(np.concatenate(each)[:clouds]) for each in zip(*found, strict=True)))
