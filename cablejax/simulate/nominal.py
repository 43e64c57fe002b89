"""Nominal cable sizes: outer diameters computed from the rules of IEC 60502-2, and the size a diameter stands for."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import ROUND_HALF_UP, Decimal

# IEC 60502-2, Table A.1: fictitious diameter d_L of the conductor in mm, by cross-section in mm2.
CONDUCTOR_MM = {
    25: 5.6, 35: 6.7, 50: 8.0, 70: 9.4, 95: 11.0, 120: 12.4, 150: 13.8,
    185: 15.3, 240: 17.5, 300: 19.5, 400: 22.6, 500: 25.2, 630: 28.3,
}  # fmt: skip

# IEC 60502-2, Table 6: nominal XLPE thickness in mm by rated voltage U0/U in kV, and the smallest size offered.
XLPE_MM = {"3.6/6": 2.5, "6/10": 3.4, "8.7/15": 4.5, "12/20": 5.5, "18/30": 8.0}
THICKER_XLPE_MM = {"3.6/6": {240: 2.6, 300: 2.8, 400: 3.0, 500: 3.2, 630: 3.2}}  # where it grows with the size
SMALLEST_MM2 = {"3.6/6": 25, "6/10": 25, "8.7/15": 25, "12/20": 35, "18/30": 50}

SEMICONDUCTING_SCREENS_MM = 3.0  # Annex A: added to the core's diameter for its two semi-conducting screens
# Table A.3: metallic screens up to 4 mm2 add 0.5 mm. One copper tape 0.1 mm x 35 mm, overlapping, is 3.5 mm2.
METALLIC_SCREEN_MM = 0.5
LEAST_SHEATH_MM = 1.4
LEAST_ARMOURED_SHEATH_MM = 1.8  # over armour
# Diameter of round armour wires by the largest fictitious diameter under the armour that they are for, in mm.
ARMOUR_WIRE_MM = ((10.0, 0.8), (15.0, 1.25), (25.0, 1.6), (35.0, 2.0), (60.0, 2.5), (math.inf, 3.15))


@dataclass(frozen=True)
class Cable:
    """A single-core cable with its nominal dimensions.

    Attributes:
        name: Unique within a catalogue.
        size_mm2: Nominal cross-section of the conductor.
        voltage_kv: Rated voltage U0/U, "8.7/15".
        diameter_mm: Outer diameter over the sheath.
        conductor_mm: Diameter of the conductor.
        insulation_mm: Thickness of the insulation.
        sheath_mm: Thickness of the outer sheath.
        source: Where the dimensions come from.
    """

    name: str
    size_mm2: float | int
    voltage_kv: str
    diameter_mm: float
    conductor_mm: float
    insulation_mm: float
    sheath_mm: float
    source: str


def tenth(thickness_mm: float) -> float:
    """Round to 0.1 mm, halves upwards, as the standard rounds thicknesses (binary floats would round 1.65 down).

    Example:
        >>> tenth(1.65)
        1.7
    """
    return float(Decimal(repr(thickness_mm)).quantize(Decimal("0.1"), rounding=ROUND_HALF_UP))


def sheath_mm(under_mm: float, *, least_mm: float = LEAST_SHEATH_MM) -> float:
    """Nominal thickness of an outer sheath over the diameter `under_mm`: 0.035 D + 1.0, not below `least_mm`.

    Example:
        >>> sheath_mm(18.1)
        1.6
    """
    return max(least_mm, tenth(round(0.035 * under_mm + 1.0, 6)))


def over_armour_mm(under_mm: float) -> float:
    """Diameter over round armour wires: an inner sheath of 0.02 D + 0.6, not below 1.2 mm, and the wires.

    Example:
        >>> over_armour_mm(30.5)  # + 2 x 1.2 + 2 x 2.0
        36.9
    """
    bedded = under_mm + 2 * max(1.2, tenth(round(0.02 * under_mm + 0.6, 6)))
    wire = next(wire for most, wire in ARMOUR_WIRE_MM if bedded <= most)
    return round(bedded + 2 * wire, 6)


def iec_cable(size_mm2: int, voltage_kv: str, *, armoured: bool = False) -> Cable:
    """Dimensions of a single-core XLPE cable with a copper tape screen, without armour or with round wires.

    The fictitious diameters of IEC 60502-2, Annex A, stand for the real ones: d_L + 2 t_i + 3.0 over the screened
    core, + 0.5 over the tape, and twice the sheath. The 1.4 mm least sheath supposes a separator over the tape.

    Raises:
        ValueError: If the size or the voltage is not in the tables.
    """
    if voltage_kv not in XLPE_MM:
        raise ValueError(f"voltage_kv: expected one of {', '.join(XLPE_MM)}, got {voltage_kv!r}")
    if size_mm2 not in CONDUCTOR_MM:
        raise ValueError(f"size_mm2: expected one of {list(CONDUCTOR_MM)}, got {size_mm2!r}")
    conductor = CONDUCTOR_MM[size_mm2]
    insulation = THICKER_XLPE_MM.get(voltage_kv, {}).get(size_mm2, XLPE_MM[voltage_kv])
    under = conductor + 2 * insulation + SEMICONDUCTING_SCREENS_MM + METALLIC_SCREEN_MM
    source = "computed: IEC 60502-2 Annex A, Table 6, sheath 0.035 D + 1.0"
    if armoured:
        under = over_armour_mm(under)
        source += ", inner sheath 0.02 D + 0.6, round wires by the diameter under the armour"
    sheath = sheath_mm(under, least_mm=LEAST_ARMOURED_SHEATH_MM if armoured else LEAST_SHEATH_MM)
    return Cable(
        name=f"XLPE {size_mm2} mm2 {voltage_kv} kV" + (" armoured" if armoured else ""),
        size_mm2=size_mm2,
        voltage_kv=voltage_kv,
        diameter_mm=round(under + 2 * sheath, 6),
        conductor_mm=conductor,
        insulation_mm=insulation,
        sheath_mm=sheath,
        source=source,
    )


def catalogue(voltage: str = "8.7/15", *, armoured: bool = False) -> tuple[Cable, ...]:
    """Single-core XLPE cables of one voltage class, smallest first; `armoured` with (non-magnetic) round wires.

    Example:
        >>> cables = catalogue()
        >>> len(cables), cables[0].diameter_mm, cables[-1].diameter_mm
        (13, 21.3, 45.6)
    """
    if voltage not in XLPE_MM:
        raise ValueError(f"voltage: expected one of {', '.join(XLPE_MM)}, got {voltage!r}")
    return tuple(iec_cable(size, voltage, armoured=armoured) for size in CONDUCTOR_MM if size >= SMALLEST_MM2[voltage])


def nominal_probabilities(diameter_mm: float | int, std_mm: float | int, cables: Sequence[Cable]) -> dict[str, float]:
    """Probability of each nominal size given a measured diameter.

    Bayes' rule with equal priors and a Gaussian measurement of standard deviation `std_mm`:
    p_i = exp(-(d - D_i)^2 / 2 s^2) / sum_j exp(-(d - D_j)^2 / 2 s^2). `std_mm` has to hold the spread of real cables
    about their nominal diameter as well as the measurement's own.

    Raises:
        ValueError: If a number is not finite, `std_mm` is not positive, or names repeat or are absent.

    Example:
        >>> p = nominal_probabilities(30.4, 0.5, catalogue())
        >>> max(p, key=p.get)
        'XLPE 150 mm2 8.7/15 kV'
    """
    if not math.isfinite(diameter_mm):
        raise ValueError(f"diameter_mm: expected a finite number, got {diameter_mm!r}")
    if not (math.isfinite(std_mm) and std_mm > 0):
        raise ValueError(f"std_mm: expected a finite number above 0, got {std_mm!r}")
    names = [cable.name for cable in cables]
    if not names or len(set(names)) < len(names):
        raise ValueError(f"cables: expected at least one, with different names, got {names}")
    logs = [-0.5 * ((diameter_mm - cable.diameter_mm) / std_mm) ** 2 for cable in cables]
    top = max(logs)  # subtracted first, so that a diameter far from every size does not give 0/0
    weights = [math.exp(value - top) for value in logs]
    return {name: weight / sum(weights) for name, weight in zip(names, weights, strict=True)}
