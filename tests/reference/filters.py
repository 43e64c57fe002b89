"""The adaptive filter, equations (2)-(8), point by point in NumPy float64."""

import numpy as np

from tests.reference.neighbors import knn


def adaptive_filter(xyz, *, k, alpha, beta, gamma, tau, order=0, form="linear"):
    """One application of the filter; points `[n, 3]` and widths `[n]`."""
    xyz = np.asarray(xyz, dtype=np.float64)
    neighbors, _ = knn(xyz, k)
    around = [np.append(i, neighbors[i]) for i in range(len(xyz))]
    noise = np.array([np.sqrt(((xyz[a] - xyz[a].mean(0)) ** 2).sum(1).mean()) for a in around])  # (2), (3)
    width = alpha * noise + beta if form == "linear" else beta * np.exp(alpha * noise / beta)  # (4), (5)
    gradient = np.zeros_like(xyz)  # (6)
    for i in range(len(xyz)):
        for j in neighbors[i]:
            apart = xyz[i] - xyz[j]
            if apart.any():
                gradient[i] += apart / np.linalg.norm(apart)
    edge = 1 + gamma * np.maximum(0, np.linalg.norm(gradient, axis=1) - tau)  # (7)
    out = np.empty_like(xyz)
    for i, near in enumerate(around):
        weight = edge[near] * np.exp(-((xyz[near] - xyz[i]) ** 2).sum(1) / (2 * width[i] ** 2))
        out[i] = xyz[i] + _surface(xyz[near] - xyz[i], weight, order)  # (8) where order is 0
    return out, width


def _surface(offsets, weight, order):
    """Where the origin moves: to the weighted mean, or along the normal onto the weighted plane or quadric."""
    mean = np.average(offsets, axis=0, weights=weight)
    if order == 0:
        return mean
    centred = offsets - mean
    axes = np.linalg.eigh(np.einsum("k,ki,kj->ij", weight, centred, centred))[1]
    normal = axes[:, 0]
    if order == 1:
        return (mean @ normal) * normal
    u, v, height = offsets @ axes[:, 2], offsets @ axes[:, 1], offsets @ normal
    terms = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=1)
    root = np.sqrt(weight)
    return np.linalg.lstsq(terms * root[:, None], height * root, rcond=None)[0][0] * normal
