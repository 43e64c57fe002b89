"""Cable surfaces in plain NumPy float64: centrelines by numerical integration, surfaces as dense meshes."""

import numpy as np

FINE_MM = 0.01  # integration step; the midpoint rule's error over 400 mm stays below 1e-8 mm at these curvatures


def curvature(shape, arc, *, length, bend_radius):
    """Curvature of the centreline at arc lengths, 1/mm, as `make_tube` documents the shapes."""
    share = arc / length
    if shape == "bend":
        return np.where((share > 0.2) & (share < 0.8), 1 / bend_radius, 0.0)
    if shape == "s-bend":
        first, second = (share > 0.1) & (share < 0.5), (share > 0.5) & (share < 0.9)
        return np.where(first, 1 / bend_radius, np.where(second, -1 / bend_radius, 0.0))
    if shape == "run":  # straight in the middle, one bend at either end
        return np.where((share > 0.05) & (share < 0.15) | (share > 0.85) & (share < 0.95), 1 / bend_radius, 0.0)
    if shape == "catenary":
        return bend_radius / (bend_radius**2 + (arc - 0.5 * length) ** 2)
    return np.zeros_like(arc)


def centreline(shape, *, length, bend_radius, step=0.5):
    """Arc lengths `[k]`, points `[k, 2]` and headings `[k]`, from 0 to `length` every `step` mm.

    The heading is the integral of the curvature, the point the integral of the heading; half-way the centreline passes
    the origin along +x.
    """
    fine = np.arange(round(length / FINE_MM)) * FINE_MM + 0.5 * FINE_MM
    heading = np.concatenate(
        [[0.0], np.cumsum(curvature(shape, fine, length=length, bend_radius=bend_radius)) * FINE_MM]
    )
    heading -= heading[len(heading) // 2]
    middle = 0.5 * (heading[1:] + heading[:-1])
    steps = np.stack([np.cos(middle), np.sin(middle)], axis=1) * FINE_MM
    points = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    points -= points[len(points) // 2]
    every = round(step / FINE_MM)
    return np.arange(len(points))[::every] * FINE_MM, points[::every], heading[::every]


def mesh(arc, points, heading, radius, *, turns):
    """Vertices `[k * turns, 3]` and triangles of the tube of radius(arc, angle) about a centreline."""
    angle = np.arange(turns) * 2 * np.pi / turns
    rho = np.broadcast_to(radius(arc[:, None], angle[None, :]), (len(arc), turns))
    normal = np.stack([-np.sin(heading), np.cos(heading)], axis=1)
    across = rho * np.cos(angle)[None, :]
    xy = points[:, None, :] + across[:, :, None] * normal[:, None, :]
    vertices = np.concatenate([xy, (rho * np.sin(angle)[None, :])[:, :, None]], axis=2).reshape(-1, 3)
    ring, turn = np.meshgrid(np.arange(len(arc) - 1), np.arange(turns), indexing="ij")
    a, b = ring * turns + turn, ring * turns + (turn + 1) % turns
    quads = np.stack([a, b, a + turns, b + turns], axis=-1).reshape(-1, 4)
    triangles = np.concatenate([quads[:, [0, 2, 1]], quads[:, [1, 2, 3]]])
    return vertices, triangles


def fit_circle(points):
    """Centre and radius of the circle through points `[n, 2]`: algebraic start, then Gauss-Newton on the distances."""
    design = np.column_stack([2 * points, np.ones(len(points))])
    solution = np.linalg.lstsq(design, np.sum(points**2, axis=1), rcond=None)[0]
    centre, radius = solution[:2], np.sqrt(solution[2] + solution[:2] @ solution[:2])
    for _ in range(5):
        off = points - centre
        distance = np.linalg.norm(off, axis=1)
        jacobian = np.column_stack([-off / distance[:, None], -np.ones(len(points))])
        step = np.linalg.lstsq(jacobian, radius - distance, rcond=None)[0]
        centre, radius = centre + step[:2], radius + step[2]
    return centre, radius
