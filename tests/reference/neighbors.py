"""Nearest neighbours in NumPy float64: measure every pair, sort by distance, then by row."""

import numpy as np


def knn(xyz, k, *, queries=None, mask=None, include_self=False):
    """Rows `[q, k]`, -1 where there are fewer, and squared distances `[q, k]`, inf there."""
    xyz = np.asarray(xyz, dtype=np.float64)
    n = len(xyz)
    valid = np.ones(n, dtype=bool) if mask is None else np.asarray(mask)
    asked = valid if queries is None else np.ones(len(queries), dtype=bool)
    targets = xyz if queries is None else np.asarray(queries, dtype=np.float64)
    neighbors = np.full((len(targets), k), -1)
    sq_dist = np.full((len(targets), k), np.inf)
    for i in np.flatnonzero(asked):
        distance = ((targets[i] - xyz) ** 2).sum(axis=1)
        usable = valid.copy()
        if queries is None and not include_self:
            usable[i] = False
        rows = np.flatnonzero(usable)
        order = rows[np.lexsort((rows, distance[rows]))][:k]
        neighbors[i, : len(order)] = order
        sq_dist[i, : len(order)] = distance[order]
    return neighbors, sq_dist


def radius_count(xyz, radius, *, queries=None, mask=None, include_self=False):
    """How many points lie at distance <= radius of each query `[q]`."""
    _, sq_dist = knn(xyz, len(xyz), queries=queries, mask=mask, include_self=include_self)
    return (sq_dist <= radius**2).sum(axis=1)
