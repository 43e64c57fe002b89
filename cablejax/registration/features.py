"""Describing a point by the shape of its surroundings: fast point feature histograms (Rusu et al. 2009), signs left out."""

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from cablejax.geometry.normals import nearest
from cablejax.registration.correspondences import Oriented

BINS = 11


def _histogram(value: np.ndarray) -> np.ndarray:
    """Shares `[n, BINS]` of values `[n, k]` between 0 and 1, each split between the two nearest bins."""
    n, place = len(value), np.clip(value, 0, 1) * (BINS - 1)
    low = np.minimum(place.astype(np.int64), BINS - 2)
    upper = place - low
    cell = np.arange(n)[:, None] * BINS + low
    counts = np.bincount(cell.ravel(), (1 - upper).ravel(), n * BINS) + np.bincount(
        cell.ravel() + 1, upper.ravel(), n * BINS
    )
    return counts.reshape(n, BINS) / value.shape[1]


def point_features(cloud: Oriented, tree: KDTree, *, k: int) -> Float[np.ndarray, "n 33"]:
    """Histograms of the angles between a point's normal, its `k` neighbours' normals, and the way there.

    The normals' signs are not known, so cosines are taken without theirs. As in FPFH each point's histogram is added to
    by its neighbours', the nearer the more.

    Args:
        cloud: Thinned evenly, with normals.
        tree: Over its points.
        k: Neighbours.
    """
    distance, near = (found[:, 1:] for found in nearest(tree, cloud.xyz, k=min(k + 1, len(cloud.xyz))))
    own = _own(cloud, distance, near)
    weight = distance[:, :1] / np.maximum(distance, 1e-12)
    weight /= weight.sum(axis=1, keepdims=True)
    return own + np.einsum("nk,nkf->nf", weight, own[near])


def _own(cloud: Oriented, distance: np.ndarray, near: Int[np.ndarray, "n k"]) -> np.ndarray:
    way = (cloud.xyz[near] - cloud.xyz[:, None, :]) / np.maximum(distance, 1e-12)[:, :, None]
    here, there = cloud.normals[:, None, :], cloud.normals[near]
    cosines = [np.abs(np.sum(a * b, axis=2)) for a, b in ((here, way), (there, way), (here, there))]
    # Angles rather than their cosines: flat surroundings would fill a single bin.
    return np.concatenate([_histogram(np.arccos(np.clip(cosine, 0, 1)) * 2 / np.pi) for cosine in cosines], axis=1)
