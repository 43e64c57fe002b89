"""How much light a surface sends back: diffuse reflectance and gloss, by part."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from cablejax.simulate.surface import Part

PARTS = 1 + max(value for name, value in vars(Part).items() if name.isupper())
GLARE_SINE = 0.15  # half-width of the mirror lobe, 8.6 degrees from the normal


class Finish(NamedTuple):
    """What the parts of a scene send back, relative to the matte sheath that a preset's figures stand for.

    Attributes:
        reflectance: Total reflectance of each part, 1 for the matte sheath `[PARTS]`.
        gloss: Share of it in a mirror lobe about the normal instead of all round, 0 to below 1 `[PARTS]`.
    """

    reflectance: Float[Array, " parts"] | np.ndarray
    gloss: Float[Array, " parts"] | np.ndarray


MATTE = Finish(np.ones(PARTS, np.float32), np.zeros(PARTS, np.float32))

# Black polymers send back a few per cent in the near infrared, coloured PVC some ten times that: a quarter of the
# matte sheath's signal stands for the former. The shares are chosen, not measured on a sheath.
FINISHES: Mapping[str, tuple[float, float]] = MappingProxyType(
    {"matte": (1.0, 0.0), "dark": (0.25, 0.0), "glossy": (1.0, 0.5), "dark-glossy": (0.25, 0.5)}
)


def finish(name: str) -> Finish:
    """The finish of that name on the sheaths of the cable and of its neighbours; everything else stays matte.

    Raises:
        ValueError: If there is none.

    Example:
        >>> finish("dark").reflectance[Part.CABLE], finish("dark").reflectance[Part.WALL]
        (np.float32(0.25), np.float32(1.0))
    """
    if name not in FINISHES:
        raise ValueError(f"finish: expected one of {', '.join(FINISHES)}, got {name!r}")
    return sheath_finish(*FINISHES[name])


def sheath_finish(reflectance: float, gloss: float) -> Finish:
    """A finish of one's own on the sheaths.

    Raises:
        ValueError: If `reflectance` is not above 0 or `gloss` not from 0 to below 1.
    """
    if not 0 < reflectance < float("inf"):
        raise ValueError(f"reflectance: expected a finite number above 0, got {reflectance!r}")
    if not 0 <= gloss < 1:
        raise ValueError(f"gloss: expected at least 0 and below 1, got {gloss!r}")
    made = Finish(MATTE.reflectance.copy(), MATTE.gloss.copy())
    for part in (Part.CABLE, Part.OTHER_CABLE):
        made.reflectance[part], made.gloss[part] = reflectance, gloss
    return made


class Light(NamedTuple):
    """What comes back from one beam.

    Attributes:
        diffuse: Diffuse reflectance of the part that was met, 1 for a matte sheath `[]`.
        signal: Lambert's law: `diffuse` times the cosine of the incidence angle `[]`.
        glare: Probability that the mirror lobe blinds the detector `[]`.
    """

    diffuse: Float[Array, ""]
    signal: Float[Array, ""]
    glare: Float[Array, ""]


def light(surfaces: Finish, part: Array, cosine: Float[Array, ""]) -> Light:
    """Signal and glare of a beam that meets a part at an incidence angle.

    diffuse = reflectance (1 - gloss), signal = diffuse cos i, glare = gloss exp(-(sin i / `GLARE_SINE`)^2).
    """
    gloss = jnp.asarray(surfaces.gloss)[part]
    diffuse = jnp.asarray(surfaces.reflectance)[part] * (1 - gloss)
    return Light(diffuse, diffuse * cosine, gloss * jnp.exp(-(1 - cosine**2) / GLARE_SINE**2))
