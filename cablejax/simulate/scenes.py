"""Scenes by name: a line, what its sheath or its accessory is, and what stands around it, at sizes that suit the cable."""

from collections.abc import Callable, Mapping
from types import MappingProxyType

from cablejax.simulate.accessories import Revolved, with_clamp, with_joint, with_stress_cone, with_termination
from cablejax.simulate.clutter import Cabling, Scene, bare, neighbours, support, tray, trefoil, wall
from cablejax.simulate.profiles import ProfiledTube, make_profiled
from cablejax.simulate.shapes import SHAPES, Tube, make_tube, straight_run


def _radius(cable: Cabling) -> float:
    return float(cable.radius_mm)


def _length(tube: Tube) -> float:
    return float(tube.length_mm)


SHEATHS: Mapping[str, Callable[[Tube], ProfiledTube]] = MappingProxyType(
    {
        "oval": lambda tube: make_profiled(tube, oval_mm=0.01 * _radius(tube)),
        "eccentric": lambda tube: make_profiled(tube, eccentric_mm=0.03 * _radius(tube)),
        "lay": lambda tube: make_profiled(tube, lay_mm=0.01 * _radius(tube)),
        "corrugated": lambda tube: make_profiled(tube, corrugation_mm=0.04 * _radius(tube)),
        "ribbed": lambda tube: make_profiled(tube, rib_mm=0.04 * _radius(tube)),
    }
)
ACCESSORIES: Mapping[str, Callable[[Tube], Revolved]] = MappingProxyType(
    {
        "joint": lambda tube: with_joint(tube, radius_mm=1.8 * _radius(tube), length_mm=0.5 * _length(tube)),
        "joint-stepped": lambda tube: with_joint(
            tube, radius_mm=1.8 * _radius(tube), length_mm=0.5 * _length(tube), taper_mm=0.0
        ),
        "stress-cone": lambda tube: with_stress_cone(
            tube, radius_mm=2.0 * _radius(tube), length_mm=0.5 * _length(tube)
        ),
        "termination": lambda tube: with_termination(tube, core_mm=0.7 * _radius(tube), shed_mm=2.0 * _radius(tube)),
        "clamp": with_clamp,
    }
)
# Shares of the length that an accessory needs straight; the cable bends before and behind.
STRAIGHT_SHARES: Mapping[str, tuple[float, float]] = MappingProxyType(
    dict.fromkeys(ACCESSORIES, (0.2, 0.8)) | {"termination": (0.4, 2.0)}
)
SURROUNDINGS: Mapping[str, Callable[[Cabling], Scene]] = MappingProxyType(
    {
        "trefoil": trefoil,
        "two-cables": lambda cable: neighbours(cable, [(3.0 * _radius(cable), 0.0)]),
        "wall": wall,
        "tray": tray,
        "support": support,
    }
)
SCENES = (*SHAPES, *SHEATHS, *ACCESSORIES, *SURROUNDINGS)


def make_scene(
    name: str, *, diameter_mm: float | int, length_mm: float | int, bend_radius_mm: float | int | None = None
) -> Scene:
    """A scene by its name, one of `SCENES`, or by several joined by "+": "bend+corrugated+tray".

    Args:
        name: At most one line (straight where none is named), one sheath or accessory, and one surrounding.
        diameter_mm: Outer diameter.
        length_mm: Length of the centreline.
        bend_radius_mm: See `make_tube`; for lines that bend alone.

    Raises:
        ValueError: If a name is unknown or does not go with another, a size is out of range, or a bend radius is given
            for a straight scene.

    Example:
        >>> len(make_scene("bend+tray", diameter_mm=30.0, length_mm=200.0).solids)
        3
    """
    line, dress, around = _parse(name)
    if line == "straight" and bend_radius_mm is not None:
        raise ValueError(f"bend_radius_mm: expected none for {name!r}, which is straight, got {bend_radius_mm!r}")
    tube = make_tube(line, diameter_mm=diameter_mm, length_mm=length_mm, bend_radius_mm=bend_radius_mm)
    cable = tube if dress is None else _dress(tube, dress, bent=line != "straight")
    return bare(cable) if around is None else SURROUNDINGS[around](cable)


def _dress(tube: Tube, name: str, *, bent: bool) -> Cabling:
    """The cable with its sheath or accessory."""
    if name in SHEATHS:
        return SHEATHS[name](tube)
    if bent:
        tube = straight_run(tube, *(share * float(tube.length_mm) for share in STRAIGHT_SHARES[name]))
    return ACCESSORIES[name](tube)


def _parse(name: str) -> tuple[str, str | None, str | None]:
    """Line, sheath or accessory, surrounding."""
    words = name.split("+")
    unknown = [word for word in words if word not in SCENES]
    if unknown:
        raise ValueError(f"shape: expected one of {', '.join(SCENES)}, or several joined by +, got {unknown[0]!r}")
    found = []
    for kind, names in (
        ("line", SHAPES),
        ("sheath or accessory", (*SHEATHS, *ACCESSORIES)),
        ("surrounding", SURROUNDINGS),
    ):
        mine = [word for word in words if word in names]
        if len(mine) > 1:
            raise ValueError(f"shape: expected at most one {kind} of {', '.join(names)}, got {' and '.join(mine)}")
        found.append(mine[0] if mine else None)
    return found[0] or "straight", found[1], found[2]
