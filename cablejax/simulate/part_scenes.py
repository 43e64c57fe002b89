"""Scenes drawn at random for `cablejax.simulate.part_clouds`: what a cable wears, what stands around it, how it is scanned."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from cablejax.simulate.accessories import Revolved, revolve, with_clamp, with_joint, with_stress_cone, with_termination
from cablejax.simulate.clutter import FLAT_MM, Neighbour, Plane, Scene, box, neighbour, support, tray
from cablejax.simulate.nominal import catalogue
from cablejax.simulate.posts import Placed, Post
from cablejax.simulate.presets import PRESETS, numbers_of
from cablejax.simulate.shapes import Tube, straight_run, two_bends
from cablejax.simulate.surface import Part, label

SCANNERS = ("line-laser", "structured-light", "paper-floor", "terrestrial")
ACCESSORIES = (None, "joint", "joint-stepped", "stress-cone", "termination", "clamp")
SURROUNDINGS = (None, "wall", "tray", "support", "trefoil")
CORNERS = 20  # of the longest accessory, four rain sheds; all scenes have as many, and share one compiled program
MOST_STRAY = 0.08  # of the points

# The wide mix.
WIDE_SCANNERS = (*SCANNERS, "paper-aligned")
WIDE_DIAMETERS_MM = (10.0, 60.0)
BESIDE = (None, "boxes", "bottle", "can", "pole", "stem")
ENDLESS_MM = 2000.0  # half the height of poles, stems and crossing cables
HOLE_MM = (15.0, 60.0)


class Drawn(NamedTuple):
    """One scene with the way it is scanned: arrays alone, so that many are stacked.

    Attributes:
        scene: What there is.
        numbers: The fields of `Scanner`.
        middle: Angle of the middle of the circumference that is seen.
        arc: How much of it is seen, radians.
        stray: Stray points as a share of the returns.
        on_cable: Whether the ball is laid about a point of the cable, or about any.
        gone: Whether the cable and what it wears are taken out of the scan, with the gap that they leave.
        hole_mm: Radius of a hole in the scan, 0 for none.
    """

    scene: Scene
    numbers: dict[str, Array]
    middle: Array
    arc: Array
    stray: Array
    on_cable: Array
    gone: Array
    hole_mm: Array


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


def _nowhere() -> Placed:
    """A solid that no beam meets."""
    one = jnp.float32(1.0)
    post = Post(one, one, jnp.float32(0.0), jnp.float32(0.0), label(Part.WALL))
    return Placed(post, jnp.eye(3), jnp.float32([0.0, 0.0, -FLAT_MM]))


def _post(
    radius_mm: float, half_mm: float, *, taper: float = 0.0, lobe_mm: float = 0.0, part: Part = Part.WALL
) -> Post:
    radius, half, slope, lobe = (jnp.float32(value) for value in (radius_mm, half_mm, taper, lobe_mm))
    return Post(radius, half, slope, lobe, label(part))


def _aside(tube: Tube, outline_mm: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A point on the cable's outline and a gap away from it, the direction outwards, and the cable's tangent there."""
    at, along = (np.asarray(each) for each in tube.centreline.at(jnp.float32(rng.uniform(0.1, 0.9) * tube.length_mm)))
    turn = rng.uniform(0.0, 2 * np.pi)
    tangent = np.array([*along, 0.0])
    out = np.cos(turn) * np.array([-along[1], along[0], 0.0]) + np.sin(turn) * np.array([0.0, 0.0, 1.0])
    return np.array([*at, 0.0]) + (outline_mm + rng.uniform(1.0, 120.0)) * out, out, tangent


def _standing(tube: Tube, outline_mm: float, posts: list[Post], rng: np.random.Generator) -> list[Placed]:
    """Posts on top of each other beside the cable, their axis at any angle to it, the first one nearest to it."""
    point, out, tangent = _aside(tube, outline_mm, rng)
    turn = rng.uniform(0.0, np.pi)
    axis = np.cos(turn) * tangent + np.sin(turn) * np.cross(out, tangent)
    rotation = jnp.asarray(np.stack([out, np.cross(axis, out), axis], axis=1), jnp.float32)
    first = point + (float(posts[0].radius_mm) + float(posts[0].lobe_mm)) * out
    height, found = -float(posts[0].half_mm), []
    for post in posts:
        height += float(post.half_mm)
        found.append(Placed(post, rotation, jnp.asarray(first + height * axis, jnp.float32)))
        height += float(post.half_mm)
    return found


def _boxes(tube: Tube, outline_mm: float, rng: np.random.Generator) -> list[Placed]:
    """Two boxes of any size, turned anyhow."""
    from scipy.spatial.transform import Rotation  # half a second, for training scenes alone

    found = []
    for _ in range(2):
        half = rng.uniform(10.0, 120.0, 3)
        point, out, _ = _aside(tube, outline_mm, rng)
        rotation = Rotation.from_quat(rng.normal(size=4)).as_matrix()
        centre = point + (np.abs(out @ rotation) @ half) * out
        solid = box((0.0, 0.0, 0.0), (half[0], half[1], half[2]), Part.WALL)
        found.append(Placed(solid, jnp.asarray(rotation, jnp.float32), jnp.asarray(centre, jnp.float32)))
    return found


def _beside(cable: Revolved, tube: Tube, what: str | None, rng: np.random.Generator) -> tuple[Placed, ...]:
    """Two boxes, then two posts and a cable that crosses; what is not there stands far away."""
    outline, boxes, posts = float(cable.outline_mm), [_box_nowhere()] * 2, []
    if what == "boxes":
        boxes = _boxes(tube, outline, rng)
    elif what in ("bottle", "can"):
        posts = [_post(rng.uniform(28.0, 52.0), rng.uniform(45.0, 110.0))]
        posts += [_post(rng.uniform(11.0, 20.0), rng.uniform(15.0, 40.0))] if what == "bottle" else []
    elif what == "pole":
        posts = [_post(rng.uniform(35.0, 150.0), ENDLESS_MM)]
    elif what == "stem":
        radius = rng.uniform(35.0, 170.0)
        taper, lobe = rng.uniform(-0.01, 0.01), rng.uniform(0.0, 0.06) * radius
        posts = [_post(radius, ENDLESS_MM, taper=taper, lobe_mm=lobe)]
    stood = _standing(tube, outline, posts, rng) if posts else []
    crossing = [_nowhere()]
    if rng.uniform() < 0.15:
        radius = 0.5 * rng.uniform(*WIDE_DIAMETERS_MM)
        crossing = _standing(tube, outline, [_post(radius, ENDLESS_MM, part=Part.OTHER_CABLE)], rng)
    return (*boxes, *stood, *[_nowhere()] * (2 - len(stood)), *crossing)


def _box_nowhere() -> Placed:
    """A box that no beam meets."""
    far = _nowhere()
    return far._replace(solid=box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), Part.WALL))


def _other_numbers(numbers: dict[str, Array], rng: np.random.Generator) -> dict[str, Array]:
    """A scanner of the same kind: its noise, footprint and drop-out are others."""
    changed = {
        "range_mm": numbers["range_mm"] * 2 ** rng.uniform(-1.0, 1.0),
        "footprint_mm": numbers["footprint_mm"] * 2 ** rng.uniform(-1.0, 1.0),
        "dropout_cos": numbers["dropout_cos"] + rng.uniform(0.0, 0.25),
        "mixed_share": rng.uniform(0.0, 1.0),
        "density_variation": rng.uniform(0.0, 0.6),
    }
    return {**numbers, **{name: jnp.float32(value) for name, value in changed.items()}}


def diameters_mm(*, wide: bool) -> tuple[float, float]:
    """Least and greatest diameter of the scanned cables."""
    sizes = [cable.diameter_mm for cable in catalogue()]
    return WIDE_DIAMETERS_MM if wide else (0.8 * min(sizes), 1.2 * max(sizes))


def draw_scene(rng: np.random.Generator, *, wide: bool) -> Drawn:
    """A scene: any diameter around the catalogue's, bends from 10 D, a dressing, surroundings, a scanner, a view.

    Args:
        rng: Where all of it comes from.
        wide: Cables of `WIDE_DIAMETERS_MM`, and `BESIDE` them what is round or flat and no cable; five scanners of other
            noise, holes, and scans without the cable.
    """
    low, high = diameters_mm(wide=wide)
    diameter = low * (high / low) ** rng.uniform() if wide else rng.uniform(low, high)
    length = rng.uniform(250.0, 550.0)
    bends = rng.uniform(-1.0, 1.0, 2) / (10 * diameter)
    accessory = ACCESSORIES[rng.choice(len(ACCESSORIES), p=[0.45, 0.12, 0.08, 0.1, 0.13, 0.12])]
    around = SURROUNDINGS[rng.choice(len(SURROUNDINGS), p=[0.3, 0.2, 0.25, 0.15, 0.1])]
    tube = two_bends(jnp.float32(diameter / 2), jnp.float32(length), jnp.float32(bends[0]), jnp.float32(bends[1]), 0.4)
    low, high = (0.4, 2.0) if accessory == "termination" else (0.2, 0.8)
    tube = straight_run(tube, low * length, high * length)
    cable = _dressed(tube, accessory, rng)
    solids = _solids(cable, tube, around, rng)
    view = rng.uniform(5.0, 120.0 if wide else 100.0)
    scanners = WIDE_SCANNERS if wide else SCANNERS
    numbers = numbers_of(PRESETS[scanners[rng.choice(len(scanners))]])
    middle, arc, stray = np.pi / 2 + rng.uniform(-0.7, 0.7), np.radians(rng.uniform(60.0, 360.0)), rng.uniform(0.0, 1.0)
    on_cable, gone, hole = rng.uniform() < 0.75, False, 0.0
    if wide:
        what = BESIDE[rng.choice(len(BESIDE), p=[0.4, 0.2, 0.1, 0.1, 0.1, 0.1])]
        solids = (*solids, *_beside(cable, tube, what, rng))
        numbers = _other_numbers(numbers, rng)
        gone = rng.uniform() < (0.25 if what else 0.03)
        hole = rng.uniform(*HOLE_MM) if rng.uniform() < 0.3 else 0.0
    return Drawn(
        Scene(_padded(cable), solids, jnp.float32(view)),  # pyright: ignore[reportArgumentType] Placed is a solid too
        numbers,
        jnp.float32(middle),
        jnp.float32(arc),
        jnp.float32(MOST_STRAY * stray),
        jnp.asarray(on_cable),
        jnp.asarray(gone),
        jnp.float32(hole),
    )
