"""Published sizes, and the laws every network obeys: padding, permutation, evaluation, rotation about the cable."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx

from cablejax.nets import MODELS, BatchNorm, build_model, count_parameters, depth_image
from cablejax.nets.baselines.pointnet2 import farthest_points
from cablejax.nets.tabulate import tabulate

B, N, CLASSES = 3, 48, 5


def clouds(extra=0, seed=0):
    """Half-cylinders in mm, with `extra` rows of padding that hold garbage."""
    rng = np.random.default_rng(seed)
    angle = np.radians(rng.uniform(-90, 90, (B, N)))
    radius = np.array([[10.0], [14.0], [20.0]]) + rng.normal(0, 0.2, (B, N))
    xyz = np.stack([rng.uniform(-50, 50, (B, N)), radius * np.cos(angle), radius * np.sin(angle)], axis=2)
    xyz -= xyz.mean(axis=1, keepdims=True)
    xyz = np.concatenate([xyz, rng.normal(0, 1e3, (B, extra, 3))], axis=1)
    mask = np.broadcast_to(np.arange(N + extra) < N, (B, N + extra))
    return jnp.asarray(xyz, jnp.float32), jnp.asarray(mask)


def small(name):
    options = {"k": 6} if name in ("adgcnn", "dgcnn") else {}
    if name == "adgcnn":
        options |= {"widths": (8, 8, 8, 16), "raster_shape": (4, 8), "raster_width": 8}
    if name == "pointnet2":
        options = {"points": (16, 8), "neighbors": (6, 4), "radii_mm": (20.0, 40.0), "dropout": 0.0}
    if name == "pointnext":
        options = {"points": (16, 8), "neighbors": 6, "radius_mm": 20.0, "dropout": 0.0}
    return build_model(name, CLASSES, rngs=nnx.Rngs(0), **options)


@partial(jax.jit, static_argnums=0)
def _run(graphdef, state, xyz, mask):
    model = nnx.merge(graphdef, state, copy=True)
    logits = model(xyz, mask)
    return logits, nnx.state(model)


def run(model, xyz, mask):
    return _run(*nnx.split(model), xyz, mask)


@pytest.mark.parametrize(
    ("name", "classes", "options", "published"),
    [
        ("alexnet", 1000, {"size": 224, "in_channels": 3}, 60_965_224),
        ("vgg16", 1000, {"size": 224, "in_channels": 3}, 138_357_544),
        ("resnet50", 1000, {"size": 224, "in_channels": 3}, 25_557_032),
    ],
)
def test_parameters_as_published(name, classes, options, published):
    model = nnx.eval_shape(lambda: build_model(name, classes, rngs=nnx.Rngs(0), **options))
    assert count_parameters(model) == published


@pytest.mark.parametrize(
    ("name", "classes", "millions"),
    [("dgcnn", 40, 1.8), ("pointnet", 40, 3.5), ("pointnet2", 40, 1.5), ("pointnext", 15, 1.4)],
)
def test_point_networks_have_the_published_size(name, classes, millions):
    model = nnx.eval_shape(lambda: build_model(name, classes, rngs=nnx.Rngs(0), pose="none"))
    assert round(count_parameters(model) / 1e6, 1) == millions


@pytest.mark.parametrize("name", ["adgcnn", "pointnet", "pointnet2", "pointnext"])
def test_padding_changes_neither_logits_nor_statistics(name):
    model = small(name)
    if name == "pointnet":
        model.classifier.dropout = None  # else the masks differ by design: streams advance
    plain, padded = (run(model, *clouds(extra)) for extra in (0, 9))
    for a, b in zip(jax.tree.leaves(plain), jax.tree.leaves(padded), strict=True):
        if jnp.issubdtype(a.dtype, jnp.floating):
            # Sums over 48 and 57 rows are associated differently; batch norm over 3 clouds magnifies that.
            np.testing.assert_allclose(a, b, rtol=2e-3, atol=2e-3)


@pytest.mark.parametrize("name", ["adgcnn", "pointnet2", "pointnext"])
def test_points_in_another_order_give_the_same_logits(name):
    model = small(name)
    model.eval()
    xyz, mask = clouds()
    order = np.random.default_rng(1).permutation(N)
    (plain, _), (shuffled, _) = run(model, xyz, mask), run(model, xyz[:, order], mask)
    np.testing.assert_allclose(shuffled, plain, rtol=1e-3, atol=1e-3)


def test_a_turned_cable_gives_the_same_prediction():
    model = small("adgcnn")
    model.eval()
    xyz, mask = clouds()
    turn = np.radians(130.0)
    rotation = jnp.array([[1, 0, 0], [0, np.cos(turn), -np.sin(turn)], [0, np.sin(turn), np.cos(turn)]], jnp.float32)
    (plain, _), (turned, _) = run(model, xyz, mask), run(model, xyz @ rotation.T, mask)
    np.testing.assert_allclose(turned, plain, rtol=5e-2, atol=5e-2)
    np.testing.assert_array_equal(turned.argmax(axis=1), plain.argmax(axis=1))


def test_each_stage_can_be_left_out():
    counts = {}
    for switches in ((0, 0, 0), (1, 0, 0), (1, 1, 0), (1, 0, 1), (1, 1, 1)):
        attention, enhancement, fusion = map(bool, switches)
        model = nnx.eval_shape(
            lambda a=attention, e=enhancement, f=fusion: build_model(
                "adgcnn", 13, rngs=nnx.Rngs(0), attention=a, enhancement=e, fusion=f
            )
        )
        counts[switches] = count_parameters(model)
    assert len(set(counts.values())) == 5
    assert counts[0, 0, 0] < counts[1, 0, 0] < counts[1, 1, 0] < counts[1, 1, 1]


def test_what_adgcnn_tells_beside_logits():
    options = {"k": 6, "widths": (8, 8), "enhancement": False, "fusion": False}
    model = build_model("adgcnn", CLASSES, rngs=nnx.Rngs(0), regression=True, **options)
    model.eval()
    ask = jax.jit(lambda *of: (model.with_diameter(*of), model(*of), model.attention_weights(*of)))
    found, logits, attention = ask(*clouds())
    np.testing.assert_allclose(found.logits, logits, atol=1e-5)
    assert found.diameter_mm.shape == (B,)
    assert float(found.std_mm.min()) > 0
    assert [each.shape for each in attention] == [(B, 8), (B, 8)]
    assert all(((each > 0) & (each < 1)).all() for each in attention)
    with pytest.raises(ValueError, match="regression=True"):
        small("adgcnn").with_diameter(*clouds())


def test_every_parameter_of_adgcnn_gets_a_gradient():
    graphdef, params, rest = nnx.split(small("adgcnn"), nnx.Param, ...)
    xyz, mask = clouds()

    @jax.jit
    def gradient(params):
        def loss(params):
            return jnp.sum(nnx.merge(graphdef, params, rest, copy=True)(xyz, mask)[:, 0] ** 3)

        return jax.grad(loss)(params)

    for path, leaf in jax.tree.leaves_with_path(gradient(params)):
        assert bool(jnp.isfinite(leaf).all()), path
        assert float(jnp.abs(leaf).max()) > 0, path


def test_an_image_network_runs_on_clouds():
    model = build_model("alexnet", CLASSES, rngs=nnx.Rngs(0))
    model.eval()
    logits, _ = run(model, *clouds())
    assert logits.shape == (B, CLASSES)
    assert bool(jnp.isfinite(logits).all())


def test_depth_image_keeps_the_nearest_point_and_metric_size():
    xyz = jnp.array([[0.0, 0.0, 5.0], [0.0, 0.0, -5.0], [20.0, 0.0, 0.0], [99.0, 0.0, 0.0], [0.0, 9.0, 0.0]])
    image = depth_image(xyz, jnp.array([True, True, True, True, False]), size=10, extent_mm=50.0)
    expected = np.zeros((10, 10))
    expected[5, 5] = 0.6  # 0.5 + 5 / 50: the nearer of two
    expected[5, 9] = 0.5  # 20 mm are 4 pixels
    np.testing.assert_allclose(image, expected, atol=1e-6)


def test_a_wide_image_has_the_pixels_of_a_square_one():
    """Of 20 columns and 10 rows over 100 mm: pixels of 5 mm, depths told apart over 50 mm, as 10 x 10 over 50 mm."""
    xyz = jnp.array([[0.0, 0.0, 5.0], [20.0, -20.0, 0.0], [-48.0, 0.0, -5.0], [0.0, 26.0, 0.0]])
    wide = depth_image(xyz, jnp.ones(4, bool), size=(10, 20), extent_mm=100.0)
    np.testing.assert_allclose(wide[:, 5:15], depth_image(xyz, jnp.ones(4, bool), size=10, extent_mm=50.0), atol=1e-6)
    assert wide[5, 0] == pytest.approx(0.6)  # beyond the square, and in sight
    assert np.count_nonzero(wide) == 3
    with pytest.raises(ValueError, match=r"size: expected at least 1, or rows and columns of at least 1, got \(4, 0\)"):
        depth_image(xyz, jnp.ones(4, bool), size=(4, 0), extent_mm=100.0)


@pytest.mark.parametrize("name", ["alexnet", "vgg16", "resnet50"])
def test_image_networks_take_wide_images(name: str):
    """Shapes alone: nothing is computed."""
    model = nnx.eval_shape(lambda: build_model(name, CLASSES, rngs=nnx.Rngs(0), size=(64, 256), extent_mm=256.0))
    model.eval()
    logits = jax.eval_shape(lambda model, *inputs: model(*inputs), model, *clouds())
    assert logits.shape == (B, CLASSES)


def test_batch_norm_equals_numpy_and_skips_rows_of_weight_zero():
    rng = np.random.default_rng(0)
    x, weight = rng.normal(1e3, 1.0, (6, 5, 3)), rng.random((6, 5)) < 0.7
    norm = BatchNorm(3, momentum=0.9)
    found = norm(jnp.asarray(x, jnp.float32), jnp.asarray(weight, jnp.float32))
    mean, var = x[weight].mean(axis=0), x[weight].var(axis=0)
    np.testing.assert_allclose(found, (x - mean) / np.sqrt(var + 1e-5), atol=2e-3)  # 1e3 in float32: steps of 6e-5
    np.testing.assert_allclose(norm.mean[...], 0.1 * mean, rtol=1e-5)
    np.testing.assert_allclose(norm.var[...], 0.9 + 0.1 * var, rtol=1e-3)


def test_farthest_points_equal_numpy():
    rng = np.random.default_rng(0)
    xyz, mask = rng.normal(size=(30, 3)), np.arange(30) < 25
    valid = xyz[mask]
    rows = [np.argmax(((valid - valid.mean(axis=0)) ** 2).sum(axis=1))]
    for _ in range(7):
        rows.append(np.argmax(np.min([((valid - valid[row]) ** 2).sum(axis=1) for row in rows], axis=0)))
    found = farthest_points(jnp.asarray(xyz, jnp.float32), jnp.asarray(mask), m=8)
    np.testing.assert_array_equal(found, rows)


def test_table_of_a_network_adds_up():
    text = tabulate("adgcnn", 13, n_points=64)
    model = nnx.eval_shape(lambda: build_model("adgcnn", 13, rngs=nnx.Rngs(0)))
    head, *rows = text.splitlines()
    assert head.startswith(f"adgcnn: {count_parameters(model):,} parameters, ")
    assert sum(int(row.split()[1].replace(",", "")) for row in rows) == count_parameters(model)


def test_unknown_names_and_options_are_refused():
    with pytest.raises(ValueError, match="name: expected one of adgcnn"):
        build_model("lenet", 3, rngs=nnx.Rngs(0))
    with pytest.raises(ValueError, match="options: pointnet"):
        build_model("pointnet", 3, rngs=nnx.Rngs(0), depth=3)
    with pytest.raises(ValueError, match="pose: expected one of"):
        build_model("adgcnn", 3, rngs=nnx.Rngs(0), pose="sideways")
    assert set(MODELS) == {
        "adgcnn",
        "adgcnn_fit",
        "dgcnn",
        "pointnet",
        "pointnet2",
        "pointnext",
        "alexnet",
        "vgg16",
        "resnet50",
    }


@pytest.mark.parametrize("name", ["adgcnn", "dgcnn", "pointnet", "pointnet2", "pointnext"])
@pytest.mark.parametrize("pose", ["none", "principal", "cylinder"])
def test_only_the_pose_cylinder_fits_anything(name, pose, monkeypatch):
    """The raster once held the fitted radius, and was unrolled about the fitted axis, whatever the pose."""

    def fitted(*args, **kwargs):
        raise RuntimeError("a cylinder was fitted")

    monkeypatch.setattr("cablejax.nets.input_channels.cylinder_frame", fitted)
    try:
        model = build_model(name, CLASSES, rngs=nnx.Rngs(0), pose=pose)
    except ValueError:
        pytest.skip(f"{name} has no pose to choose")
    graphdef, state = nnx.split(model)
    call = partial(jax.eval_shape, lambda state, *cloud: nnx.merge(graphdef, state, copy=True)(*cloud), state)
    if pose == "cylinder":
        with pytest.raises(RuntimeError, match="a cylinder was fitted"):
            call(*clouds())
    else:
        assert call(*clouds()).shape == (B, CLASSES)
