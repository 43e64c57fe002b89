"""Scans for the page."""

import numpy as np


def two_cables(n: int = 3000, seed: int = 0) -> np.ndarray:
    """Points of cables of 20 and 28 mm beside each other, seen from above, noise .05 mm, `[2 n, 3]`."""
    rng = np.random.default_rng(seed)
    parts = []
    for radius, aside in ((10.0, 0.0), (14.0, 60.0)):
        angle, x = rng.uniform(0, np.pi, n), rng.uniform(0, 240, n)
        r = radius + 0.05 * rng.normal(size=n)
        parts.append(np.stack([x, aside + r * np.cos(angle), r * np.sin(angle)], axis=1))
    return np.concatenate(parts)
