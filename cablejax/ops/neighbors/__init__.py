"""Exact neighbour search in float32 inside jit: the k nearest, those within a radius, and how many there are.

The folder can be lifted out alone: it needs jax, `cablejax/ops/cloud_by_cloud.py`, `cablejax/ops/varying.py` and
`cablejax/types.py`. `index.py` (a tree and what it is asked), `knn.py` and `radius.py` are what callers see; a search goes
`request` (checked arguments), `tree` (`segments` for ragged batches), `search`, which uses `descent` (down the tree), `rank`
(choosing among candidates), `select` (thresholds without sorting) and `metric` (distances, also in a periodic box).
Small clouds and feature spaces compare all pairs, in `dense` and `brute`.
"""

from cablejax.ops.neighbors.index import (
    KnnResult,
    RadiusCount,
    RadiusResult,
    SearchTree,
    build_tree,
    query,
    query_count,
    query_radius,
)
from cablejax.ops.neighbors.knn import ListAndSums, distance_sums, knn, knn_features, neighbors_and_sums
from cablejax.ops.neighbors.radius import radius_count, radius_search

__all__ = [
    "KnnResult",
    "ListAndSums",
    "RadiusCount",
    "RadiusResult",
    "SearchTree",
    "build_tree",
    "distance_sums",
    "knn",
    "knn_features",
    "neighbors_and_sums",
    "query",
    "query_count",
    "query_radius",
    "radius_count",
    "radius_search",
]
