"""The classification dataset: clouds of simulated cables at metric scale, labelled by nominal size."""

from dataclasses import dataclass
from functools import partial
from typing import Literal, NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, PRNGKeyArray

from cablejax.simulate.clouds import VERSIONS, draw_cloud, limits_of, raster_of
from cablejax.simulate.nominal import XLPE_MM, catalogue
from cablejax.simulate.pose import canonical_pose, centred
from cablejax.simulate.presets import numbers_of

Version = Literal["clean", "standard", "hard", "real-like"]
SplitName = Literal["train", "validation", "test"]
CHUNK = 64  # clouds a compiled call; fixed, so that a cloud's bytes do not depend on how many are asked for


class Split(NamedTuple):
    """Clouds with their labels.

    Attributes:
        xyz: Points in mm, centred on their mean `[clouds, n, 3]`.
        mask: True where a row is a point `[clouds, n]`.
        label: Index into `DatasetConfig.sizes_mm2` `[clouds]`.
        diameter_mm: True outer diameter `[clouds]`.
        on_cable: True where a point lies on the cable, and not on a wall, another cable or in the air `[clouds, n]`; None
            where it is not known.
    """

    xyz: Float[Array, "clouds n 3"]
    mask: Bool[Array, "clouds n"]
    label: Int[Array, " clouds"]
    diameter_mm: Float[Array, " clouds"]
    on_cable: Bool[Array, "clouds n"] | None = None


@dataclass(frozen=True)
class DatasetConfig:
    """What the clouds are like.

    Attributes:
        sizes_mm2: Nominal cross-sections, one class each.
        n_points: Points a cloud, 256 to 2,048 for the networks here; any number from 16 works.
        clouds_per_class: Clouds of each class in one split.
        version: "clean", "standard", "hard" or "real-like", see `cablejax.simulate.clouds.VERSIONS`.
        canonical_pose: True turns each cloud's estimated axis to x; False leaves it at a random rotation.
        seed: Root of every random draw.
        voltage: Voltage class of the catalogue.
    """

    sizes_mm2: tuple[float | int, ...] = (25, 50, 95, 150, 240, 400)
    n_points: int = 1024
    clouds_per_class: int = 64
    version: str = "standard"
    canonical_pose: bool = True
    seed: int = 0
    voltage: str = "8.7/15"

    def __post_init__(self) -> None:
        if self.voltage not in XLPE_MM:
            raise ValueError(f"voltage: expected one of {', '.join(XLPE_MM)}, got {self.voltage!r}")
        offered = [cable.size_mm2 for cable in catalogue(self.voltage)]
        unknown = [size for size in self.sizes_mm2 if size not in offered]
        if not self.sizes_mm2 or unknown or len(set(self.sizes_mm2)) < len(self.sizes_mm2):
            raise ValueError(f"sizes_mm2: expected different sizes out of {offered}, got {list(self.sizes_mm2)}")
        if self.n_points < 16:
            raise ValueError(f"n_points: expected at least 16, got {self.n_points!r}")
        if self.clouds_per_class < 1:
            raise ValueError(f"clouds_per_class: expected at least 1, got {self.clouds_per_class!r}")
        if self.version not in VERSIONS:
            raise ValueError(f"version: expected one of {', '.join(VERSIONS)}, got {self.version!r}")

    @property
    def diameters_mm(self) -> tuple[float, ...]:
        """Nominal diameter of each class."""
        by_size = {cable.size_mm2: cable.diameter_mm for cable in catalogue(self.voltage)}
        return tuple(by_size[size] for size in self.sizes_mm2)


@partial(jax.jit, static_argnames=("lines", "columns", "n_points", "cluttered", "canonical"))
def _clouds(nominal_mm, numbers, limits, split, index, key, *, lines, columns, n_points, cluttered, canonical):
    """Clouds in their pose: points `[b, n, 3]`, masks `[b, n]`, diameters `[b]`, which points are the cable's `[b, n]`."""
    draw = partial(draw_cloud, lines=lines, columns=columns, n_points=n_points, cluttered=cluttered)
    keys = jax.vmap(jax.random.fold_in, in_axes=(None, 0))(key, index)
    drawn = jax.vmap(draw, in_axes=(0, None, None, None, 0))(nominal_mm, numbers, limits, split, keys)
    return jax.vmap(canonical_pose if canonical else centred)(*drawn[:2]), *drawn[1:]


def _draw(config: DatasetConfig, split: int, label: Array, index: Array, key: PRNGKeyArray):
    """`_clouds` of a configuration: labels `[b]`, and `[b]` numbers that tell the clouds apart."""
    version = VERSIONS[config.version]
    lines, columns = raster_of(version, config.n_points)
    return _clouds(
        jnp.asarray(config.diameters_mm, jnp.float32)[label], numbers_of(version.scanner), limits_of(version),
        jnp.int32(split), index, key,
        lines=lines, columns=columns, n_points=config.n_points, cluttered=version.clutter > 0,
        canonical=config.canonical_pose,
    )  # fmt: skip


def make_split(config: DatasetConfig, split: str) -> Split:
    """The train, validation or test clouds: every class equally often, the same bytes for the same configuration.

    The splits share nothing: each has a random stream of its own, and bend curvatures and station directions come from
    intervals that do not overlap those of the other splits (`cablejax.simulate.clouds.stratified`).

    Raises:
        ValueError: If `split` is unknown.

    Example:
        >>> split = make_split(DatasetConfig(sizes_mm2=(95, 240), n_points=128, clouds_per_class=2), "test")
        >>> split.xyz.shape, split.label.tolist()
        ((4, 128, 3), [0, 1, 0, 1])
    """
    if split not in get_args(SplitName):
        raise ValueError(f"split: expected one of {', '.join(get_args(SplitName))}, got {split!r}")
    number = get_args(SplitName).index(split)
    classes = len(config.sizes_mm2)
    total = classes * config.clouds_per_class
    key = jax.random.fold_in(jax.random.key(config.seed), number)
    parts = []
    for start in range(0, total, CHUNK):
        index = jnp.arange(start, start + CHUNK)
        done = jax.tree.map(np.asarray, _draw(config, number, index % classes, index, key))
        parts.append([array[: total - start] for array in done])
    xyz, mask, *rest = (jnp.asarray(np.concatenate(arrays)) for arrays in zip(*parts, strict=True))
    return Split(xyz, mask, jnp.arange(total) % classes, *rest)


def sample_clouds(config: DatasetConfig, n: int, *, key: PRNGKeyArray) -> Split:
    """Fresh training clouds, one compiled call: for networks that never see a cloud twice.

    Args:
        config: What the clouds are like; `seed` and `clouds_per_class` have no say here.
        n: How many. Static. Every class comes up n / classes times, in random order; the first ones once more
            where that is no whole number.
        key: Consumed.
    """
    if n < 1:
        raise ValueError(f"n: expected at least 1, got {n!r}")
    key_order, key_clouds = jax.random.split(key)
    label = jax.random.permutation(key_order, jnp.arange(n) % len(config.sizes_mm2))
    xyz, mask, *rest = _draw(config, 0, label, jnp.arange(n), key_clouds)
    return Split(xyz, mask, label, *rest)
