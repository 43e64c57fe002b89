"""Noise of a given signal-to-noise ratio on top of a scan: Gaussian, random (impulsive) and compound."""

from typing import Literal, get_args

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PRNGKeyArray

from cablejax.simulate.scan import Scan
from cablejax.simulate.surface import signed_distance

Kind = Literal["gaussian", "random", "compound"]
IMPULSE_SHARE = 0.05  # the paper does not say how many points its random noise hits


def noise_mm(xyz_mm: Float[Array, "n 3"], snr_db: float | int) -> Float[Array, ""]:
    """Standard deviation per coordinate of noise at a signal-to-noise ratio.

    SNR = 10 log10(P_signal / P_noise), where P_signal is the mean squared distance of the points to their centroid and
    P_noise the mean squared displacement. So the standard deviation per coordinate is
    sqrt(P_signal / 3) 10^(-snr_db / 20): on a cable of 400 mm at 60, 80, 100 and 120 dB 0.07 mm, 7 um, 0.7 um, 0.07 um.
    """
    centred = xyz_mm - jnp.mean(xyz_mm, axis=0)[None, :]
    power = jnp.mean(jnp.sum(centred * centred, axis=1))
    return jnp.sqrt(power / 3) * 10 ** (-snr_db / 20)


def add_noise(
    scan: Scan,
    *,
    kind: str = "gaussian",
    snr_db: float | int,
    impulse_share: float | int = IMPULSE_SHARE,
    key: PRNGKeyArray,
) -> Scan:
    """Displace the points of a scan; the truth follows.

    All kinds have the same power at the same `snr_db` (see `noise_mm` for the definition):

    - "gaussian": every coordinate of every point by N(0, s^2);
    - "random", impulsive: a share of the points, chosen one by one with probability `impulse_share`, each coordinate by
      a uniform draw from +-s sqrt(3 / impulse_share); the others stay;
    - "compound": both, each with half the power.

    Args:
        scan: The scan.
        kind: "gaussian", "random" or "compound".
        snr_db: Signal-to-noise ratio in dB.
        impulse_share: Probability that the impulsive noise hits a point.
        key: Consumed.

    Returns:
        A scan with new `xyz_mm`, `signed_distance_mm` and `is_impulse`; `is_outlier` says as before which points hung
        in the air.

    Raises:
        ValueError: If `kind` is unknown or `impulse_share` is not within (0, 1].
    """
    if kind not in get_args(Kind):
        raise ValueError(f"kind: expected one of {', '.join(get_args(Kind))}, got {kind!r}")
    if not 0 < impulse_share <= 1:
        raise ValueError(f"impulse_share: expected above 0 and at most 1, got {impulse_share!r}")
    share = {"gaussian": (1.0, 0.0), "random": (0.0, 1.0), "compound": (0.5, 0.5)}[kind]
    std = noise_mm(scan.xyz_mm, snr_db)
    key_normal, key_hit, key_size = jax.random.split(key, 3)
    n = scan.xyz_mm.shape[0]
    step = share[0] ** 0.5 * std * jax.random.normal(key_normal, (n, 3))
    hit = jax.random.bernoulli(key_hit, impulse_share, (n,)) & (share[1] > 0)
    reach = (3 * share[1] / impulse_share) ** 0.5 * std
    step = step + jnp.where(hit[:, None], reach * jax.random.uniform(key_size, (n, 3), minval=-1.0), 0.0)
    xyz = scan.xyz_mm + step
    return scan._replace(
        xyz_mm=xyz,
        signed_distance_mm=signed_distance(scan.surface, xyz),
        is_impulse=scan.is_impulse | hit,
    )
