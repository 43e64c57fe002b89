"""Many small symmetric systems at once, unrolled: entries are arrays over the systems, so that one loop does all of it."""

import jax.numpy as jnp
from jaxtyping import Array

TINY = float(jnp.finfo(jnp.float32).tiny)
PIVOT = 1e-3  # least share of a term that the terms before it may leave unexplained; float32 sums are right to 1e-6


def cholesky(matrix: list[Array], m: int) -> tuple[list[list[Array]], list[Array], list[Array]]:
    """Lower factors of matrices given by their lower triangles row by row, unrolled.

    With them each pivot, what of a term the terms before it leave unexplained, and whether that is more than rounding.
    Where it is not, 1 stands in its place: the factors are not used there, but their gradient must be finite.
    """
    lower: list[list[Array]] = [[] for _ in range(m)]
    pivots, distinct, entries = [], [], iter(matrix)
    for i in range(m):
        for j in range(i + 1):
            whole = entry = next(entries)
            for p in range(j):
                entry = entry - lower[i][p] * lower[j][p]
            if i == j:
                pivots.append(entry)
                distinct.append((entry > PIVOT * whole) & (entry > TINY**0.5))
                entry = jnp.sqrt(jnp.where(distinct[i], entry, 1.0))
            lower[i].append(entry if i == j else entry / lower[j][j])
    return lower, pivots, distinct


def forward(lower: list[list[Array]], right: list[Array]) -> list[Array]:
    """What lower factors make into the right sides, of which those left out are zero."""
    found: list[Array] = []
    for i, row in enumerate(lower):
        entry = right[i] if i < len(right) else jnp.zeros_like(right[0])
        for p in range(i):
            entry = entry - row[p] * found[p]
        found.append(entry / row[i])
    return found


def backward(lower: list[list[Array]], right: list[Array]) -> list[Array]:
    """What the transposes of lower factors make into the right sides."""
    m, x = len(right), list(right)
    for i in reversed(range(m)):
        for p in range(i + 1, m):
            x[i] = x[i] - lower[p][i] * x[p]
        x[i] = x[i] / lower[i][i]
    return x


def sum_of_squares(values: list[Array]) -> Array:
    """Without a start at 0, which would be one more addition."""
    first, *others = values
    total = jnp.square(first)
    for each in others:
        total = total + jnp.square(each)
    return total
