"""Voxel means against a dictionary in NumPy float64, and against Open3D."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cablejax.ops import voxel_downsample
from cablejax.types import Status

N = 120


def voxels_by_dictionary(xyz: np.ndarray, size: float, usable: np.ndarray, origin: np.ndarray) -> dict:
    cells: dict[tuple, list[int]] = {}
    for row in np.flatnonzero(usable):
        cells.setdefault(tuple(np.floor((xyz[row] - origin) / size).astype(int).tolist()), []).append(int(row))
    return dict(sorted(cells.items()))


def assert_means(found, xyz: np.ndarray, size: float, usable: np.ndarray, origin: np.ndarray, atol: float) -> None:
    expected = voxels_by_dictionary(xyz.astype(np.float64), size, usable, origin)
    total, voxel = len(expected), np.asarray(found.voxel)
    assert int(found.total) == total
    for number, rows in enumerate(expected.values()):
        assert (voxel[rows] == number).all()
        np.testing.assert_allclose(found.xyz[number], xyz[rows].astype(np.float64).mean(axis=0), atol=atol)
        assert int(found.count[number]) == len(rows)
    assert (voxel[~usable] == -1).all()
    assert not np.asarray(found.count)[total:].any()
    assert not np.asarray(found.xyz)[total:].any()


@pytest.mark.parametrize("axes", [1, 2, 3])
@pytest.mark.parametrize("offset", [0.0, -1.5, 2.0**20])
def test_means_and_counts_also_far_from_the_origin(axes, offset):
    # Sixteenths: exact at 2^20 too, where the mean of raw coordinates would be off by whole voxels.
    xyz = (np.random.default_rng(1).integers(-40, 40, size=(N, axes)) / 16 + offset).astype(np.float32)
    found = voxel_downsample(jnp.asarray(xyz), size=0.5)
    # A float32 at 2^20 is right to a sixteenth at worst, near the origin to 3e-7.
    atol = 0.0626 if offset > 100 else 1e-6
    assert_means(found, xyz, 0.5, np.ones(N, dtype=bool), xyz.min(axis=0).astype(np.float64), atol)
    assert int(found.status) == 0


def test_masked_rows_an_origin_and_values_that_are_not_finite():
    xyz = (np.random.default_rng(1).integers(-40, 40, size=(N, 3)) / 16).astype(np.float32)
    mask = np.arange(N) % 4 > 0
    xyz[1] = np.inf
    usable, origin = mask & (np.arange(N) != 1), np.array([0.25, -7.0, 0.0])
    found = voxel_downsample(
        jnp.asarray(xyz), size=1.0, mask=jnp.asarray(mask), origin=jnp.asarray(origin, dtype=jnp.float32)
    )
    assert_means(found, np.where(usable[:, None], xyz, 0), 1.0, usable, origin, 1e-6)
    assert int(found.status) == Status.NOT_FINITE


def test_the_last_voxels_find_no_room():
    xyz = jnp.array([[3.0], [0.0], [1.0], [2.0], [0.5]])
    found = voxel_downsample(xyz, size=1.0, capacity=2)
    assert found.xyz[:, 0].tolist() == [0.25, 1.0]
    assert (found.count.tolist(), found.voxel.tolist()) == ([2, 1], [-1, 0, 1, -1, 0])
    assert (int(found.total), int(found.status)) == (4, Status.CAPACITY_EXCEEDED)


def test_a_voxel_of_many_points_keeps_its_digits():
    xyz = (1000.0 + np.random.default_rng(1).random((100_000, 1))).astype(np.float32)
    found = voxel_downsample(jnp.asarray(xyz), size=10.0, capacity=1)
    # One rounding at 1,000 is 3e-5.
    np.testing.assert_allclose(found.xyz[0, 0], xyz.astype(np.float64).mean(), atol=4e-5)
    assert int(found.count[0]) == 100_000


def test_a_grid_of_more_voxels_than_integers_number():
    xyz = np.array([[0, 0, 0], [1e9, 1e9, 1e9], [1e9, 1e9, 1e9], [1e9, 0, 1e9]], dtype=np.float32)
    found = voxel_downsample(jnp.asarray(xyz), size=1e-3)
    assert (found.voxel.tolist(), found.count.tolist()) == ([0, 2, 2, 1], [1, 1, 2, 0])


@pytest.mark.parametrize("size", [0.0, -1.0, float("nan"), float("inf")])
def test_a_size_that_is_none_gives_nothing_and_says_so(size):
    found = voxel_downsample(jnp.zeros((4, 3)), size=size)
    assert (int(found.total), int(found.status)) == (0, Status.INVALID)
    assert found.voxel.tolist() == [-1] * 4


def test_an_empty_cloud_has_no_voxels():
    found = voxel_downsample(jnp.zeros((4, 3)), size=1.0, mask=jnp.zeros(4, dtype=bool))
    assert (int(found.total), int(found.status)) == (0, Status.EMPTY)


def test_as_open3d(open3d_cloud):
    xyz = np.random.default_rng(1).random((N, 3)).astype(np.float32)
    theirs = np.asarray(open3d_cloud(xyz).voxel_down_sample(0.25).points)
    # Open3D's grid begins half a voxel before the cloud.
    origin = jnp.asarray(xyz.min(axis=0) - 0.125)
    found = voxel_downsample(jnp.asarray(xyz), size=0.25, origin=origin)
    ours = np.asarray(found.xyz)[np.asarray(found.count) > 0]
    assert len(ours) == len(theirs)
    np.testing.assert_allclose(ours[np.lexsort(ours.T)], theirs[np.lexsort(theirs.T)], atol=1e-6)


def test_under_vmap_and_x64_with_gradients():
    xyz = jnp.asarray(np.random.default_rng(1).random((2, N, 3)), dtype=jnp.float32)
    with jax.enable_x64():
        both = jax.vmap(lambda xyz: voxel_downsample(xyz, size=0.3, capacity=80))(xyz)
        assert both.voxel.dtype == both.count.dtype == both.total.dtype == both.status.dtype == jnp.int32
    one = voxel_downsample(xyz[0], size=0.3, capacity=80)
    np.testing.assert_array_equal(both.voxel[0], one.voxel)
    pull = jnp.asarray(np.random.default_rng(2).normal(size=(80, 3)), dtype=jnp.float32)
    gradient = jax.grad(lambda x: jnp.sum(pull * voxel_downsample(x, size=0.3, capacity=80).xyz))(xyz[0])
    share = np.asarray(pull) / np.maximum(np.asarray(one.count), 1)[:, None]
    np.testing.assert_allclose(gradient, share[np.asarray(one.voxel)], atol=1e-6)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"capacity": 0}, "capacity: expected at least 1, got 0"),
        ({"size": jnp.ones(3)}, r"size: expected one number, got shape \[3\]"),
        ({"origin": jnp.ones(2)}, r"origin: expected shape \[3\], got \[2\]"),
        ({"mask": jnp.ones(3, dtype=bool)}, r"mask: .* \[4\]"),
    ],
)
def test_bad_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        voxel_downsample.__wrapped__.__wrapped__(jnp.zeros((4, 3)), **{"size": 1.0, **arguments})
