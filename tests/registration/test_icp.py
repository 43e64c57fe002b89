"""Registration against a textbook version and known motions; what a surface does not show is reported and left alone."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from cablejax.io import read_points
from cablejax.registration import icp, register, surface_normals, voxel_means
from cablejax.registration.voxels import voxel_pyramid
from cablejax.types import PointCloud, Status
from tests.reference.circles import bent_cable
from tests.reference.icp import plane_icp


def motion(degrees=(1.0, -2.0, 1.5), shift=(0.02, -0.01, 0.03)) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_euler("xyz", degrees, degrees=True).as_matrix()
    T[:3, 3] = shift
    return T


def moved(T: np.ndarray, xyz: np.ndarray) -> np.ndarray:
    return xyz @ T[:3, :3].T + T[:3, 3]


def corner(n=3000, noise=0.002, seed=0) -> np.ndarray:
    """Three faces of a cube of side 1."""
    rng = np.random.default_rng(seed)
    xyz = rng.uniform(size=(n, 3))
    xyz[np.arange(n), np.arange(n) % 3] = 0
    return xyz + noise * rng.normal(size=xyz.shape)


@pytest.fixture(scope="module")
def pair():
    T = motion()
    return moved(np.linalg.inv(T), corner(seed=1)), corner(seed=2), T


@pytest.mark.parametrize("method", ["point", "plane", "gicp"])
def test_known_motion_is_found(pair, method):
    source, target, T = pair
    found = icp(source, target, method=method, max_distance=0.15)
    error = np.linalg.inv(T) @ found.T_target_source
    # Noise .002 on 1,000 points a face; point-to-point also carries the sampling, 1 / sqrt(1,000) = .03 apart.
    tolerance = 5e-3 if method == "point" else 1e-3
    assert np.linalg.norm(error[:3, 3]) < tolerance
    assert np.linalg.norm(Rotation.from_matrix(error[:3, :3]).as_rotvec()) < tolerance
    assert found.converged
    assert found.seen.all()
    assert found.status == Status.OK


def test_equals_the_textbook_where_everything_is_seen(pair):
    source, target, _ = pair
    found = icp(source, target, method="plane", max_distance=0.15)
    expected = plane_icp(source, target, surface_normals(target, k=20), reach=0.15, steps=found.iterations + 5)
    # Both end at the same fixed point; float32 steps and a tolerance of 1e-5 spacings.
    np.testing.assert_allclose(found.T_target_source, expected, atol=2e-5)


@pytest.mark.parametrize("kernel", ["huber", "cauchy", "tukey"])
def test_robust_kernels_withstand_moved_points(pair, kernel):
    source, target, T = pair
    broken = source.copy()
    broken[::5] += np.array([0.0, 0.0, 0.06])
    plain = icp(broken, target, max_distance=0.15)
    robust = icp(broken, target, max_distance=0.15, kernel=kernel)

    def error(found):
        return np.linalg.norm((np.linalg.inv(T) @ found.T_target_source)[:3, 3])

    assert error(robust) < 0.5 * error(plain)


def test_a_straight_cable_does_not_turn_or_slide():
    target = bent_cable(arc_deg=180.0, noise=0.02, n=4000)
    wanted = motion(degrees=(0.0, 0.2, -0.2), shift=(0.0, 0.3, -0.2))
    source = moved(np.linalg.inv(wanted), bent_cable(arc_deg=180.0, noise=0.02, n=4000, seed=1))
    found = icp(source, target, method="plane", max_distance=5.0)
    assert (~found.seen).sum() == 2
    assert found.status & Status.DEGENERATE
    unseen = found.directions[:, ~found.seen]
    axial = np.array([1.0, 0, 0])
    # Both unseen motions are along and about the axis: their rotations are parallel to it, and across it nothing moves
    # by more than the noise of the normals.
    assert np.abs(np.cross(unseen[3:].T, axial)).max() < 1e-3
    # The source did not slide, and lies on the cable's surface: its distance from the axis, the x axis, is the radius
    # everywhere. Tangent planes at corresponding points 1.2 mm away lie 1.2^2 / 2r = .05 mm outside a cylinder of 15 mm.
    back = moved(found.T_target_source, source)
    assert abs((back - source).mean(axis=0)[0]) < 0.1
    off = np.hypot(back[:, 1], back[:, 2]) - 15
    columns = np.stack([back[:, 1], back[:, 2], np.ones(len(back)) * 15], axis=1) / 15
    np.testing.assert_allclose(np.linalg.lstsq(columns, off, rcond=None)[0], 0, atol=0.05)
    # Nothing is claimed about what was not seen; noisy normals give its direction to about 1e-3.
    assert np.abs(found.covariance @ np.array([1.0, 0, 0, 0, 0, 0])).max() < 5e-3 * np.abs(found.covariance).max()


def test_covariance_is_that_of_the_scatter():
    base = motion()
    twists = []
    for seed in range(12):
        source = moved(np.linalg.inv(base), corner(n=600, noise=0.01, seed=10 + seed))
        found = icp(source, corner(n=3000, noise=0.0, seed=99), max_distance=0.2)
        error = found.T_target_source @ np.linalg.inv(base)
        twists.append(error[:3, :3] @ found.center + error[:3, 3] - found.center)
    measured, claimed = np.std(twists, axis=0), np.sqrt(np.diag(found.covariance)[:3])
    # Twelve draws give a standard deviation to 20 %; the target's own normals add to the scatter.
    assert (measured / claimed > 0.5).all()
    assert (measured / claimed < 2.5).all()


def test_the_unit_and_the_origin_do_not_matter(pair):
    source, target, _ = pair
    found = icp(source, target, max_distance=0.15)
    far = np.array([4e5, 5.6e6, 300.0])
    other = icp(1000 * source + far, 1000 * target + far, max_distance=150.0)
    np.testing.assert_allclose(other.T_target_source[:3, :3], found.T_target_source[:3, :3], atol=1e-6)
    np.testing.assert_allclose(
        moved(other.T_target_source, 1000 * source + far) - far, 1000 * moved(found.T_target_source, source), atol=2e-2
    )
    np.testing.assert_allclose(other.observability, found.observability, atol=1e-4)


def test_padding_is_left_out(pair):
    source, target, _ = pair
    padded = PointCloud.from_xyz(source, capacity=3100)
    same = icp(np.asarray(padded.xyz[:3000]), target, max_distance=0.15)
    found = icp(padded._replace(xyz=padded.xyz.at[3000:].set(jnp.nan)), target, max_distance=0.15)
    np.testing.assert_array_equal(found.T_target_source, same.T_target_source)


def test_clouds_too_far_apart_are_empty():
    found = icp(corner(), corner() + 100.0, max_distance=0.1)
    assert found.status & Status.EMPTY
    assert not found.converged
    np.testing.assert_array_equal(found.T_target_source, np.eye(4))


def test_a_start_is_used(pair):
    source, target, T = pair
    found = icp(source, target, T_init=T, max_distance=0.15)
    assert found.iterations <= 8
    assert found.converged


@pytest.mark.parametrize(("option", "value"), [("method", "line"), ("kernel", "welsch")])
def test_unknown_options_are_named(option, value):
    with pytest.raises(ValueError, match=f"{option}: expected one of .*, got '{value}'"):
        icp.__wrapped__(corner(), corner(), **{option: value})


def test_coarser_levels_are_the_means_too():
    xyz = np.random.default_rng(0).uniform(-3, 3, size=(500, 3))
    coarse, fine = voxel_pyramid(xyz, [1.0, 0.5], spread=True)
    np.testing.assert_allclose(coarse.xyz, voxel_means(xyz, 1.0), atol=1e-12)
    assert coarse.points.sum() == fine.points.sum() == 500
    # The spread of a coarse voxel: its fine ones' own, and what their means scatter about its mean.
    inside = (np.floor(fine.xyz) == np.floor(coarse.xyz[0])).all(axis=1)
    off = fine.xyz[inside] - coarse.xyz[0]
    np.testing.assert_allclose(coarse.spread[0, 0], (fine.spread[inside, 0] + off[:, 0] ** 2).mean(), atol=1e-12)


def test_correspondences_are_the_nearest_after_every_step(pair):
    # Carried points must end where a tree that is asked at every step ends.
    source, target, _ = pair
    found = icp(source, target, method="point", max_distance=0.15, max_iterations=7)
    T, tree = np.eye(4), KDTree(target)
    for _ in range(7):
        distance, near = tree.query(moved(T, source), distance_upper_bound=0.15)
        p, q = moved(T, source)[np.isfinite(distance)], target[near[np.isfinite(distance)]]
        T = gauss_newton_point(p, q) @ T
    np.testing.assert_allclose(found.T_target_source, T, atol=2e-5)


def gauss_newton_point(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """One step on |p + v + w x p - q|^2, written out."""
    rows = np.concatenate(
        [np.tile(np.eye(3), (len(p), 1)), np.concatenate([np.cross(np.eye(3), x).T for x in p])], axis=1
    )
    twist = np.linalg.lstsq(rows, (q - p).ravel(), rcond=None)[0]
    center, hat = q.mean(axis=0), np.zeros((4, 4))
    hat[:3, :3] = np.cross(np.eye(3), twist[3:])
    hat[:3, 3] = twist[:3] + np.cross(twist[3:], center)
    T, there = expm(hat), np.eye(4)
    there[:3, 3] = center
    return there @ T @ np.linalg.inv(there)


def test_real_lidar_pair_from_the_identity(data_dir):
    folder = data_dir / "registration" / "small_gicp"
    clouds = [read_points(folder / name, unit="m").xyz_mm / 1000 for name in ("source.ply", "target.ply")]
    source, target = (cloud[np.abs(cloud).sum(axis=1) > 0] for cloud in clouds)
    truth = np.loadtxt(folder / "T_target_source.txt")
    found = register(source, target, voxels=(0.5, 0.25, 0.125))
    error = np.linalg.inv(truth) @ found.T_target_source
    assert np.linalg.norm(error[:3, 3]) < 0.005
    assert np.linalg.norm(Rotation.from_matrix(error[:3, :3]).as_rotvec()) < 0.006
    assert found.seen.all()
