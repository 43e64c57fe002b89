"""Scenes by name: the plain shapes, sheaths that are not round, accessories and clutter at sizes that suit the cable."""

from collections.abc import Callable, Mapping
from types import MappingProxyType

from cablejax.simulate.accessories import with_clamp, with_joint, with_stress_cone, with_termination
from cablejax.simulate.clutter import Scene, bare, neighbours, support, tray, trefoil, wall
from cablejax.simulate.profiles import make_profiled
from cablejax.simulate.shapes import SHAPES, Tube, make_tube


def _radius(tube: Tube) -> float:
    return float(tube.radius_mm)


def _length(tube: Tube) -> float:
    return float(tube.length_mm)


STRAIGHT_SCENES: Mapping[str, Callable[[Tube], Scene]] = MappingProxyType(
    {
        "oval": lambda tube: bare(make_profiled(tube, oval_mm=0.01 * _radius(tube))),
        "eccentric": lambda tube: bare(make_profiled(tube, eccentric_mm=0.03 * _radius(tube))),
        "lay": lambda tube: bare(make_profiled(tube, lay_mm=0.01 * _radius(tube))),
        "corrugated": lambda tube: bare(make_profiled(tube, corrugation_mm=0.04 * _radius(tube))),
        "ribbed": lambda tube: bare(make_profiled(tube, rib_mm=0.04 * _radius(tube))),
        "joint": lambda tube: bare(with_joint(tube, radius_mm=1.8 * _radius(tube), length_mm=0.5 * _length(tube))),
        "joint-stepped": lambda tube: bare(
            with_joint(tube, radius_mm=1.8 * _radius(tube), length_mm=0.5 * _length(tube), taper_mm=0.0)
        ),
        "stress-cone": lambda tube: bare(
            with_stress_cone(tube, radius_mm=2.0 * _radius(tube), length_mm=0.5 * _length(tube))
        ),
        "termination": lambda tube: bare(
            with_termination(tube, core_mm=0.7 * _radius(tube), shed_mm=2.0 * _radius(tube))
        ),
        "clamp": lambda tube: bare(with_clamp(tube)),
        "trefoil": trefoil,
        "two-cables": lambda tube: neighbours(tube, [(0.0, 3.0 * _radius(tube), 0.0)]),
        "wall": wall,
        "tray": tray,
        "support": support,
    }
)
SCENES = (*SHAPES, *STRAIGHT_SCENES)


def make_scene(
    name: str, *, diameter_mm: float | int, length_mm: float | int, bend_radius_mm: float | int | None = None
) -> Scene:
    """A scene by its name, one of `SCENES`.

    Raises:
        ValueError: If the name is unknown, a size is out of range, or a bend radius is given for a straight scene.

    Example:
        >>> len(make_scene("tray", diameter_mm=30.0, length_mm=200.0).solids)
        3
    """
    if name in SHAPES:
        return bare(make_tube(name, diameter_mm=diameter_mm, length_mm=length_mm, bend_radius_mm=bend_radius_mm))
    if name not in STRAIGHT_SCENES:
        raise ValueError(f"shape: expected one of {', '.join(SCENES)}, got {name!r}")
    if bend_radius_mm is not None:
        raise ValueError(f"bend_radius_mm: expected none for {name!r}, which is straight, got {bend_radius_mm!r}")
    return STRAIGHT_SCENES[name](make_tube("straight", diameter_mm=diameter_mm, length_mm=length_mm))
