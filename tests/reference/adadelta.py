"""Adadelta as printed, eqs. (15)-(19), in float64."""

import numpy as np


def descend(gradient, theta: np.ndarray, steps: int, *, rho: float = 0.95, eps: float = 1e-6) -> np.ndarray:
    """Every theta on the way, `[steps + 1, p]`."""
    squared_gradient = np.zeros_like(theta)
    squared_update = np.zeros_like(theta)
    path = [theta]
    for _ in range(steps):
        g = gradient(theta)
        squared_gradient = rho * squared_gradient + (1 - rho) * g**2  # eq. (17)
        update = -np.sqrt(squared_update + eps) / np.sqrt(squared_gradient + eps) * g  # eq. (18)
        squared_update = rho * squared_update + (1 - rho) * update**2
        theta = theta + update  # eq. (19)
        path.append(theta)
    return np.array(path)
