"""Signed distances and beams against dense meshes in Open3D, built in float64 from independent formulas."""

import ctypes

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cablejax.simulate import (
    bare,
    catalogue,
    locate,
    make_profiled,
    make_tube,
    simulate_scan,
    with_joint,
    with_termination,
)
from cablejax.simulate.beams import Beam, aim, cast
from cablejax.simulate.shapes import straight_run
from tests.reference.simulate import centreline, fit_circle, mesh

RADIUS, LENGTH, BEND = 15.0, 120.0, 120.0
PROFILE = {"oval_mm": 0.3, "eccentric_mm": 0.5, "lay_mm": 0.15, "lay_pitch_mm": 150.0, "corrugation_mm": 0.4,
           "rib_mm": 0.4}  # fmt: skip
TURNS, STEP = 900, 0.2
# A chord of length c lies c^2 / 8R off its arc. Around: 0.105^2 / 8 x (1/15 + 0.12 of a rib's top) = 2.5e-4 mm;
# along: 0.2^2 / 8 x (1/105 + 0.04 of a ring) = 2.5e-4 mm; float32 coordinates of 75 mm: 1e-5 mm.
MESH_MM = 1e-3  # twice the two together


@pytest.fixture(scope="module")
def open3d():
    libusb = pytest.importorskip("libusb_package")
    ctypes.CDLL(str(libusb.get_library_path()), mode=ctypes.RTLD_GLOBAL)
    return pytest.importorskip("open3d")


def profile_radius(arc, angle):
    """The radius that `PROFILE` stands for, written out."""
    eccentric = 0.5 * np.cos(angle) + np.sqrt(RADIUS**2 - (0.5 * np.sin(angle)) ** 2)
    lay = 0.15 * np.cos(12 * angle - 2 * np.pi * arc / 150.0)
    ribs = 0.4 * np.exp(4 * (np.cos(4 * angle) - 1))
    return eccentric + 0.3 * np.cos(2 * angle) + lay + 0.4 * np.cos(2 * np.pi * arc / 20.0) + ribs


def build(name):
    """Our surface, and the same as mesh arrays."""
    if name == "profiled":
        tube = make_profiled(
            make_tube("bend", diameter_mm=2 * RADIUS, length_mm=LENGTH, bend_radius_mm=BEND), **PROFILE
        )
        return tube, mesh(*centreline("bend", length=LENGTH, bend_radius=BEND, step=STEP), profile_radius, turns=TURNS)
    if name in ("joint", "termination", "joint in a run"):
        tube = make_tube("straight", diameter_mm=2 * RADIUS, length_mm=LENGTH)
        if name == "joint in a run":
            tube = straight_run(
                make_tube("bend", diameter_mm=2 * RADIUS, length_mm=LENGTH, bend_radius_mm=BEND),
                0.15 * LENGTH,
                0.85 * LENGTH,
            )
        made = (
            with_joint(tube, radius_mm=25.0, length_mm=50.0, taper_mm=0.0)
            if name != "termination"
            else with_termination(tube, core_mm=10.0, shed_mm=28.0, sheds=2)
        )
        corners, rho = (np.asarray(x, np.float64) for x in (made.arc_mm, made.rho_mm))
        # long thin triangles cost Open3D its digits
        line = centreline("run" if "run" in name else "straight", length=LENGTH, bend_radius=BEND, step=0.5)
        extra = np.setdiff1d(line[0], corners)
        arc = np.concatenate([corners, extra])
        order = np.argsort(arc, kind="stable")
        rho = np.concatenate([rho, np.interp(extra, corners, rho)])[order]
        arc = arc[order]
        # between the grid's places the line is straight wherever there is a corner
        points = np.column_stack([np.interp(arc, line[0], line[1][:, axis]) for axis in (0, 1)])
        heading = np.interp(arc, line[0], line[2])
        return made, mesh(arc, points, heading, lambda arc, angle: rho[:, None] + 0 * angle, turns=TURNS)
    tube = make_tube(name, diameter_mm=2 * RADIUS, length_mm=LENGTH, bend_radius_mm=BEND)
    arrays = centreline(name, length=LENGTH, bend_radius=BEND, step=STEP)
    return tube, mesh(*arrays, lambda arc, angle: RADIUS + 0 * arc * angle, turns=TURNS)


def raycaster(open3d, vertices, triangles):
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        open3d.core.Tensor(vertices.astype(np.float32)), open3d.core.Tensor(triangles.astype(np.uint32))
    )
    return scene


point_many = jax.jit(lambda surface, arc, angle: jax.vmap(surface.point)(arc, angle))
cast_many = jax.jit(jax.vmap(cast, in_axes=(None, 0)))
aim_many = jax.jit(jax.vmap(aim, in_axes=(None, 0, 0, 0, 0, None, None)))


@pytest.mark.parametrize(
    "name", ["straight", "bend", "s-bend", "catenary", "profiled", "joint", "termination", "joint in a run"]
)
def test_against_a_dense_mesh(open3d, name):
    surface, arrays = build(name)
    scene = raycaster(open3d, *arrays)
    rng = np.random.default_rng(3)

    # distances: points within 3 mm of the sheath, away from the mesh's open ends
    arc, angle = rng.uniform(20, LENGTH - 20, 2000), rng.uniform(-np.pi, np.pi, 2000)
    on = point_many(surface, jnp.asarray(arc, jnp.float32), jnp.asarray(angle, jnp.float32))
    points = on + jnp.asarray(rng.uniform(-1.7, 1.7, (2000, 3)), jnp.float32)
    place = locate(surface, points)
    distance = scene.compute_distance(open3d.core.Tensor(np.asarray(points))).numpy()
    assert np.abs(np.abs(place.signed_distance_mm) - distance).max() < MESH_MM
    foot = points - place.signed_distance_mm[:, None] * place.normal
    smooth = name not in (
        "joint",
        "termination",
        "joint in a run",
    )  # at an edge the nearest point is not below along a face's normal
    assert float(jnp.abs(locate(surface, foot).signed_distance_mm).max()) < 1e-4 or not smooth
    assert np.abs(np.linalg.norm(place.normal, axis=1) - 1).max() < 1e-5

    # signs, half a millimetre off the surface
    lifted = locate(surface, on).normal
    assert bool((locate(surface, on + 0.5 * lifted).signed_distance_mm > 0).all())
    assert bool((locate(surface, on - 0.5 * lifted).signed_distance_mm < 0).all())

    # beams from a travelling head, all round, at all incidences
    beams = aim_many(
        surface, *(jnp.asarray(x, jnp.float32) for x in (arc, arc, rng.uniform(-1, 1, 2000), angle)),
        jnp.float32(250.0), jnp.float32(0.5),
    )  # fmt: skip
    echo = cast_many(bare(surface), beams)
    rays = np.concatenate([beams.origin_mm, beams.direction], axis=1).astype(np.float32)
    theirs = scene.cast_rays(open3d.core.Tensor(rays))["t_hit"].numpy()
    assert (np.asarray(echo.range_mm)[np.asarray(echo.hit)] > 0).all()  # no beam meets what lies behind the scanner
    on_the_beam(beams, echo)
    steep = np.asarray(echo.cosine) > 0.1
    both = np.asarray(echo.hit) & np.isfinite(theirs) & steep
    assert both.sum() > 800
    gap = np.abs(np.asarray(echo.range_mm) - theirs)[both] * np.asarray(echo.cosine)[both]
    if smooth:
        assert gap.max() < MESH_MM
        # they may disagree on hit or miss only where the beam grazes: by 0.05 mm, or by a rib's height
        rim = 0.05 if name != "profiled" else 0.5
        clear = np.asarray(echo.margin_mm) > rim
        assert np.isfinite(theirs)[clear & np.asarray(echo.hit)].all()
        assert not np.isfinite(theirs)[np.asarray(echo.margin_mm) < -rim].any()
    else:
        # a beam that touches an edge within the chord error goes one way here and the other way there
        assert np.quantile(gap, 0.99) < MESH_MM


def on_the_beam(beams, echo):
    """Also a beam that misses ends on itself, at its closest approach: coordinates of 250 mm are known to 1.5e-5 mm."""
    off = np.asarray(echo.xyz_mm - (beams.origin_mm + echo.range_mm[:, None] * beams.direction))
    assert np.linalg.norm(off, axis=1).max() < 2e-4
    assert float(echo.range_mm.max()) < 400


def test_beam_object_is_unit_length():
    tube = make_tube("bend", diameter_mm=30.0, length_mm=200.0)
    zero = jnp.zeros(())
    beam = aim(tube, zero + 90, zero + 120, zero + 0.7, zero + 1, zero + 250, zero)
    assert isinstance(beam, Beam)
    assert float(jnp.linalg.norm(beam.direction)) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("diameter", [21.3, 45.6])
def test_noise_free_section_gives_the_diameter(diameter):
    tube = make_tube("straight", diameter_mm=diameter, length_mm=LENGTH)
    angle = jnp.linspace(-np.pi, np.pi, 2000)
    zero = jnp.zeros(2000)
    beams = aim_many(tube, zero + 60, zero + 60, zero + 0.3, angle, jnp.float32(250.0), jnp.float32(0.0))
    echo = cast_many(bare(tube), beams)
    assert bool(echo.hit.all())
    _, radius = fit_circle(np.asarray(echo.xyz_mm, np.float64)[:, 1:])
    assert 2 * radius == pytest.approx(diameter, abs=1e-4)


def test_robust_circle_fit_of_an_ideal_scan_with_outliers():
    cable = catalogue()[8]
    scan = simulate_scan(cable, n_points=4000, preset="ideal", outlier_fraction=0.1, key=jax.random.key(2))
    points = np.asarray(scan.xyz_mm, np.float64)[:, 1:]
    for _ in range(12):  # trimmed at three times the median residual of the last round
        centre, radius = fit_circle(points)
        residual = np.abs(np.linalg.norm(points - centre, axis=1) - radius)
        points = points[residual <= max(3 * np.median(residual), 1e-4)]
    assert len(points) > 3500
    assert 2 * radius == pytest.approx(cable.diameter_mm, abs=1e-4)


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({"oval_mm": 1.0}, "oval_mm: expected 0 to 5 %"),
        ({"rib_mm": -0.1}, "rib_mm"),
        ({"lay_pitch_mm": float("nan")}, "lay_pitch_mm"),
        ({"ribs": 0}, "ribs: expected 1 to 12"),
    ],
)
def test_profile_refuses(options, word):
    with pytest.raises(ValueError, match=word):
        make_profiled(make_tube("straight", diameter_mm=30.0, length_mm=100.0), **options)


def test_accessories_need_a_straight_cable():
    with pytest.raises(ValueError, match="tube: expected a cable that is straight from 64 to 136 mm"):
        with_joint(make_tube("bend", diameter_mm=30.0, length_mm=200.0), radius_mm=20.0, length_mm=50.0)
