"""The adaptive filter, eqs. (2)-(8), and its surfaces, point by point in NumPy float64."""

import numpy as np

from tests.reference.neighbors import knn


def adaptive_filter(xyz, *, k, alpha, beta, gamma, tau, order=0, form="linear", refinements=0):
    """One application of the filter; points `[n, 3]` and widths `[n]`."""
    xyz = np.asarray(xyz, dtype=np.float64)
    neighbors, _ = knn(xyz, k)
    around = [np.append(i, neighbors[i]) for i in range(len(xyz))]
    noise = np.array([np.sqrt(((xyz[a] - xyz[a].mean(0)) ** 2).sum(1).mean()) for a in around])  # (2), (3)
    width = alpha * noise + beta if form == "linear" else beta * np.exp(alpha * noise / beta)  # (4), (5)
    edge = edge_weight(xyz, neighbors, gamma, tau)
    fits = [surface(xyz[a] - xyz[a[0]], edge[a] * gauss(xyz[a] - xyz[a[0]], width[a[0]]), order) for a in around]
    place = xyz + [fit[0] for fit in fits]  # (8) where order is 0
    reach = [np.linalg.norm(xyz[a] - xyz[a[0]], axis=1).max() for a in around]
    for _ in range(refinements):
        normal = np.array([fit[1] for fit in fits])
        trust = np.array(
            [np.exp(-0.5 * ((p - x) ** 2).sum() / (3 * f[2]) ** 2) for p, x, f in zip(place, xyz, fits, strict=True)]
        )
        weights = [
            edge[a] * trust[a] * gauss(place[a] - place[a[0]], width[a[0]])
            * np.exp((np.abs(normal[a] @ normal[a[0]]) - 1) / 0.6**2)
            for a in around
        ]  # fmt: skip
        again = [surface(xyz[a] - place[a[0]], w, order) for a, w in zip(around, weights, strict=True)]
        for i, (old, new) in enumerate(zip(fits, again, strict=True)):
            if new[3] >= old[3] and np.linalg.norm(place[i] + new[0] - xyz[i]) <= reach[i]:
                fits[i], place[i] = new, place[i] + new[0]
    return place, width


def edge_weight(xyz, neighbors, gamma, tau):
    """Weight of each point, (6) and (7)."""
    gradient = np.zeros_like(xyz)
    for i in range(len(xyz)):
        for j in neighbors[i]:
            apart = xyz[i] - xyz[j]
            if apart.any():
                gradient[i] += apart / np.linalg.norm(apart)
    return 1 + gamma * np.maximum(0, np.linalg.norm(gradient, axis=1) - tau)


def gauss(offsets, width):
    return np.exp(-(offsets**2).sum(1) / (2 * width**2))


def surface(offsets, weight, order):
    """Where the origin moves: to the weighted mean, or along the normal onto the weighted plane or quadric.

    With it the normal, the weighted standard deviation from the surface, its coefficients allowed for, and its degree:
    1 instead of 2 where a quadric would rest on the origin alone or pass farther off than the neighbours lie.
    """
    weight = weight / weight.sum()
    mean = weight @ offsets
    if order == 0:
        return mean, None, None, 0
    centred = offsets - mean
    axes = np.linalg.eigh(np.einsum("k,ki,kj->ij", weight, centred, centred))[1]
    normal, u, v = axes[:, 0], offsets @ axes[:, 2], offsets @ axes[:, 1]
    terms = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=1)[:, : 3 if order == 1 else 6]
    root, height, alike = np.sqrt(weight), offsets @ normal, (weight**2).sum()
    solution = np.linalg.lstsq(terms * root[:, None], height * root, rcond=None)[0]
    leverage = np.linalg.pinv((terms * weight[:, None]).T @ terms)[0, 0]
    if order == 2 and (leverage * alike >= 0.9 or solution[0] ** 2 > weight @ (offsets**2).sum(1)):
        return surface(offsets, weight, 1)
    free = max(1 - terms.shape[1] * alike, 0.2)
    noise = np.sqrt(weight @ (height - terms @ solution) ** 2 / free)
    return solution[0] * normal, normal, noise, order
