"""Edge convolution edge by edge in float64, eqs. (11)-(14)."""

import numpy as np


def graph(features: np.ndarray, k: int, mask: np.ndarray) -> np.ndarray:
    """The k nearest valid rows of each valid row, itself first, ties by index; -1 where there are fewer."""
    n = len(features)
    result = np.full((n, k), -1)
    valid = np.flatnonzero(mask)
    for i in valid:
        distance = ((features[valid] - features[i]) ** 2).sum(axis=1)
        distance[valid == i] = -1.0
        order = valid[np.argsort(distance, kind="stable")][:k]
        result[i, : len(order)] = order
    return result


def edge_values(features: np.ndarray, neighbors: np.ndarray, kernel: np.ndarray) -> dict[tuple[int, int], np.ndarray]:
    """W [x_i, x_j - x_i] of every edge (i, j), eq. (11)."""
    return {
        (i, j): np.concatenate([features[i], features[j] - features[i]]) @ kernel
        for i, row in enumerate(neighbors)
        for j in row
        if j >= 0
    }


def attention(values: np.ndarray, squeeze, squeeze_bias, excite, excite_bias) -> np.ndarray:
    """Eq. (12) over edges `[e, d]`."""

    def shared(pooled):
        return np.maximum(pooled @ squeeze + squeeze_bias, 0.0) @ excite + excite_bias

    return 1.0 / (1.0 + np.exp(-(shared(values.max(axis=0)) + shared(values.mean(axis=0)))))


def edge_conv(features, neighbors, kernel, scale, shift, weights=None, slope=0.2) -> np.ndarray:
    """Eqs. (11)-(14) of one cloud, normalisation folded; rows without neighbours are zero."""
    edges = {edge: scale * value + shift for edge, value in edge_values(features, neighbors, kernel).items()}
    beta = np.ones(kernel.shape[1]) if weights is None else attention(np.array(list(edges.values())), *weights)
    result = np.zeros((len(features), kernel.shape[1]))
    for i in range(len(features)):
        own = [beta * value for (start, _), value in edges.items() if start == i]
        if own:
            best = np.max(own, axis=0)
            result[i] = np.where(best > 0, best, slope * best)
    return result
