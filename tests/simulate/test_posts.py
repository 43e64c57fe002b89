"""Posts and placed solids: distances and normals against plain formulas, and steps that no beam can take too far."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cablejax.simulate.clutter import box
from cablejax.simulate.posts import Placed, Post
from cablejax.simulate.surface import Part, label

TURN = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
TURN = TURN * np.linalg.det(TURN)
CENTRE = np.array([40.0, -20.0, 7.0])


def post(radius: float = 30.0, half: float = 80.0, taper: float = 0.0, lobe: float = 0.0) -> Post:
    return Post(*(jnp.float32(each) for each in (radius, half, taper, lobe)), part=label(Part.WALL))  # pyright: ignore[reportCallIssue]


def plain_distance(xyz: np.ndarray, radius: float, half: float) -> np.ndarray:
    """Signed distance of a capped cylinder in float64."""
    side, cap = np.hypot(xyz[:, 0], xyz[:, 1]) - radius, np.abs(xyz[:, 2]) - half
    outside = np.hypot(np.maximum(side, 0), np.maximum(cap, 0))
    return np.where(np.maximum(side, cap) > 0, outside, np.maximum(side, cap))


def queries(n: int = 400) -> np.ndarray:
    return np.random.default_rng(0).uniform(-150, 150, (n, 3))


def test_a_plain_post_has_the_distance_of_a_capped_cylinder():
    xyz = queries()
    distance, normal = jax.jit(jax.vmap(post().near))(jnp.asarray(xyz, jnp.float32))
    np.testing.assert_allclose(distance, plain_distance(xyz, 30.0, 80.0), atol=1e-3)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0, atol=1e-5)
    # A step along the normal from outside lands on the surface.
    out = np.asarray(distance) > 1.0
    landed = xyz[out] - np.asarray(distance)[out, None] * np.asarray(normal)[out]
    np.testing.assert_allclose(plain_distance(landed, 30.0, 80.0), 0.0, atol=2e-3)


@pytest.mark.parametrize("on_axis", [[0.0, 0.0, 0.0], [0.0, 0.0, 100.0]])
def test_the_axis_gives_finite_distances_and_normals(on_axis: list[float]):
    distance, normal = post(lobe=1.5).near(jnp.asarray(on_axis))
    assert np.isfinite(distance)
    assert np.isfinite(normal).all()


def test_no_step_reaches_through_a_stem():
    """The stem's surface lies nowhere nearer than the step that is told, by brute force over its surface."""
    radius, half, taper, lobe = 60.0, 200.0, 0.01, 3.0
    stem, xyz = post(radius, half, taper, lobe), queries(200)
    z, angle = np.meshgrid(np.linspace(-half, half, 801), np.linspace(-np.pi, np.pi, 721), indexing="ij")
    rho = radius + taper * z + lobe * np.cos(3 * angle + z / radius)
    surface = np.stack([rho * np.cos(angle), rho * np.sin(angle), z], axis=-1).reshape(-1, 3)
    step = np.asarray(jax.vmap(stem.signed_distance)(jnp.asarray(xyz, jnp.float32)))
    free = step > 5.0
    nearest = np.array([np.sqrt(((surface - each) ** 2).sum(axis=1).min()) for each in xyz[free]])
    assert free.sum() > 50
    assert (step[free] <= nearest).all()
    on = np.asarray(jax.vmap(stem.near)(jnp.asarray(surface[::5000], jnp.float32))[0])
    np.testing.assert_allclose(on, 0.0, atol=1e-3)


@pytest.mark.parametrize("solid", [post(), box((0.0, 0.0, 0.0), (20.0, 30.0, 40.0), Part.WALL)], ids=["post", "box"])
def test_a_placed_solid_is_the_solid_seen_from_its_own_coordinates(solid):
    placed = Placed(solid, jnp.asarray(TURN, jnp.float32), jnp.asarray(CENTRE, jnp.float32))
    own = jnp.asarray(queries(100), jnp.float32)
    there = jnp.asarray(np.asarray(own) @ TURN.T + CENTRE, jnp.float32)
    want, got = jax.vmap(solid.near)(own), jax.vmap(placed.near)(there)
    np.testing.assert_allclose(got[0], want[0], atol=1e-3)
    # At an edge's bisector rounding chooses the side; compare normals by what they say of the distance.
    np.testing.assert_allclose(np.linalg.norm(got[1], axis=1), 1.0, atol=1e-5)
    agree = np.sum(np.asarray(got[1]) * (np.asarray(want[1]) @ TURN.T), axis=1)
    assert np.mean(agree > 0.999) > 0.95
    assert placed.part == Part.WALL
