"""Exact neighbour search in float32 inside jit: the k nearest, those within a radius, and how many there are.

The folder can be lifted out alone: it needs jax, `cablejax/ops/cloud_by_cloud.py`, `cablejax/ops/varying.py` and
`cablejax/types.py`. `knn.py` and `radius.py` are what callers see; a search goes `request` (checked arguments), `tree`,
`search`, which uses `descent` (down the tree), `rank` (choosing among candidates) and `select` (thresholds without sorting).
Small clouds and feature spaces compare all pairs, in `dense` and `brute`.
"""

from cablejax.ops.neighbors.knn import (
    KnnResult,
    ListAndSums,
    distance_sums,
    knn,
    knn_features,
    neighbors_and_sums,
)
from cablejax.ops.neighbors.radius import RadiusCount, RadiusResult, radius_count, radius_search

__all__ = [
    "KnnResult",
    "ListAndSums",
    "RadiusCount",
    "RadiusResult",
    "distance_sums",
    "knn",
    "knn_features",
    "neighbors_and_sums",
    "radius_count",
    "radius_search",
]
