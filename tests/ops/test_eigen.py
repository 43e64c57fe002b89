"""Eigenvalues and eigenvectors in closed form against LAPACK, most of all where eigenvalues are equal."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cablejax.ops import symmetric_eigen

eigen_of = jax.jit(symmetric_eigen)

KINDS = {
    "apart": lambda r: r.random((500, 3)),
    "of any size": lambda r: 10.0 ** r.uniform(-8, 0, (500, 3)),
    "of both signs": lambda r: r.normal(size=(500, 3)),
    "a line": lambda r: r.random((500, 1)) * [1.0, 0.0, 0.0],
    "a plane": lambda r: r.random((500, 1)) * [1.0, 1.0, 0.0],
    "a ball": lambda r: r.random((500, 1)) * [1.0, 1.0, 1.0],
    "nearly equal": lambda r: np.stack(
        [np.ones(500), 1 + 10.0 ** r.uniform(-8, -1, 500), 10.0 ** r.uniform(-8, 0, 500)], axis=1
    ),
    "tiny": lambda r: r.random((500, 3)) * 1e-30,
    "huge": lambda r: r.random((500, 3)) * 1e30,
    "nothing": lambda _: np.zeros((500, 3)),
}


def matrices(kind: str) -> np.ndarray:
    rng = np.random.default_rng(0)
    turn = np.linalg.qr(rng.normal(size=(500, 3, 3)))[0]
    made = np.einsum("nij,nj,nkj->nik", turn, KINDS[kind](rng), turn)
    made[:5] = np.array([np.diag(d) for d in [(1, 2, 3), (3, 1, 1), (1, 3, 1), (0, 0, 1), (0, 1, 0)]]) * made.max()
    return made.astype(np.float32)


@pytest.mark.parametrize("kind", KINDS)
def test_they_are_those_of_lapack(kind):
    given = matrices(kind)
    values, vectors = (np.asarray(each, dtype=np.float64) for each in eigen_of(jnp.asarray(given)))
    exact = given.astype(np.float64)
    largest = np.abs(np.linalg.eigvalsh(exact)).max(axis=1)[:, None] + 1e-300
    # Some tens of roundings of 6e-8.
    assert (np.abs(values - np.linalg.eigvalsh(exact)) <= 2e-6 * largest).all()
    left = np.einsum("nij,npj->npi", exact, vectors) - values[..., None] * vectors
    assert (np.abs(left) <= 3e-6 * largest[..., None]).all()
    np.testing.assert_allclose(np.einsum("npi,nqi->npq", vectors, vectors), np.eye(3)[None].repeat(500, 0), atol=2e-6)
    np.testing.assert_allclose(np.linalg.det(vectors), 1.0, atol=3e-6)
    assert (np.diff(values, axis=1) >= 0).all()


def test_derivatives_are_those_of_lapack_and_finite_where_eigenvalues_are_equal():
    given = jnp.asarray(matrices("of both signs")[5:30])

    def cost(eigen):
        def of(given):
            values, rows = eigen(given)
            return jnp.sum(jnp.sin(3 * values)) + jnp.sum(jnp.cos(jnp.abs(rows)) * jnp.arange(9.0).reshape(1, 3, 3))

        return of

    def by_lapack(given):
        values, columns = jnp.linalg.eigh(given)
        return values, jnp.swapaxes(columns, -1, -2)

    ours, theirs = (jax.jit(jax.grad(cost(eigen)))(given) for eigen in (symmetric_eigen, by_lapack))
    # Where two eigenvalues lie a hundredth apart the derivative is a hundred times as large, and so is its error.
    np.testing.assert_allclose(ours, theirs, rtol=2e-3, atol=2e-3)
    gradient = jax.jit(jax.grad(cost(symmetric_eigen)))
    for kind in ("a line", "a plane", "a ball", "nothing"):
        assert np.isfinite(np.asarray(gradient(jnp.asarray(matrices(kind))))).all()


def test_under_vmap_and_x64():
    given = jnp.asarray(matrices("apart"))
    with jax.enable_x64():
        values, vectors = jax.jit(jax.vmap(symmetric_eigen))(given)
        assert values.dtype == vectors.dtype == jnp.float32
        double = eigen_of(given.astype(jnp.float64)).values
    np.testing.assert_allclose(values, eigen_of(given).values, atol=1e-6)
    np.testing.assert_allclose(double, np.linalg.eigvalsh(np.asarray(given, dtype=np.float64)), atol=1e-13)
