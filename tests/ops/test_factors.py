"""Small systems solved entry by entry against NumPy's."""

import jax
import numpy as np

from cablejax.ops.factors import backward, cholesky, forward, sum_of_squares

M = 50


@jax.jit
def solved(matrix, right):
    """Solutions of the first three and of all terms, leverages of the first term, and which terms are distinct."""
    lower, _, distinct = cholesky(list(matrix), 6)
    found, centre = forward(lower, list(right)), forward(lower, [right[0] * 0 + 1])
    both = backward(lower, found[:3]), backward(lower, found)
    explained = sum_of_squares(found[:3]), sum_of_squares(found)
    return both, explained, (sum_of_squares(centre[:3]), sum_of_squares(centre)), distinct


def systems():
    rng = np.random.default_rng(0)
    root = rng.normal(size=(M, 9, 6))
    return np.einsum("mki,mkj->mij", root, root) / 9 + 0.1 * np.eye(6), rng.normal(size=(M, 6))


def rows(matrix):
    """Lower triangles row by row, each entry over all systems."""
    return np.stack([matrix[:, i, j] for i in range(6) for j in range(i + 1)]).astype(np.float32)


def test_solutions_and_what_they_explain_are_those_of_numpy():
    matrix, right = systems()
    both, explained, leverage, distinct = solved(rows(matrix), right.T.astype(np.float32))
    for terms, solution, square, own in zip((3, 6), both, explained, leverage, strict=True):
        part, wanted = matrix[:, :terms, :terms], right[:, :terms, None]
        expected = np.linalg.solve(part, wanted)
        # float32 at conditions of some hundred.
        np.testing.assert_allclose(np.stack(solution, axis=1), expected[..., 0], rtol=1e-3, atol=1e-4)
        np.testing.assert_allclose(square, (wanted * expected).sum(axis=(1, 2)), rtol=1e-3)
        np.testing.assert_allclose(own, np.linalg.inv(part)[:, 0, 0], rtol=1e-3)
    assert all(each.all() for each in distinct)


def test_a_term_that_is_a_mixture_of_those_before_it_is_not_distinct():
    matrix, right = systems()
    mix = np.eye(6)
    mix[4] = [0.5, -1.0, 0, 2.0, 0, 0]  # the fifth term out of three before it
    both, _, _, distinct = solved(rows(mix @ matrix @ mix.T), right.T.astype(np.float32))
    assert [bool(each.all()) for each in distinct] == [True, True, True, True, False, True]
    assert not distinct[4].any()
    assert np.isfinite(np.stack(both[1])).all()
