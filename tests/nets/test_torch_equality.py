"""ADGCNN equals the same network in PyTorch, weight for weight: values, statistics, gradients (tests/golden)."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx

from cablejax.nets import build_model
from cablejax.nets.input_channels import PosedClouds

GOLDEN = Path(__file__).resolve().parents[1] / "golden" / "adgcnn.npz"
PADDING = 16


@pytest.fixture(scope="module")
def golden():
    with np.load(GOLDEN) as file:
        return dict(file)


def named(golden, kind):
    return {key.removeprefix(kind + "/"): value for key, value in golden.items() if key.startswith(kind + "/")}


def dotted(path):
    return ".".join(str(getattr(key, "key", getattr(key, "name", key))) for key in path).removesuffix(".value")


def filled(tree, values):
    """The tree with the arrays of the file, which must cover it exactly."""
    left = dict(values)
    filled = jax.tree.map_with_path(lambda path, leaf: jnp.asarray(left.pop(dotted(path))).reshape(leaf.shape), tree)
    assert not left, f"left over: {sorted(left)}"
    return filled


def by_name(tree):
    return {dotted(path): np.asarray(leaf) for path, leaf in jax.tree.leaves_with_path(tree)}


def padded(posed):
    """The clouds with rows of padding that hold garbage, and their mask."""
    rows = [np.concatenate([each, np.full((len(each), PADDING, *each.shape[2:]), 7.0)], axis=1) for each in posed]
    mask = np.arange(rows[1].shape[1]) < posed[1].shape[1]
    return PosedClouds(*(jnp.asarray(each, jnp.float32) for each in rows)), jnp.broadcast_to(mask, rows[1].shape)


@pytest.fixture(scope="module")
def network():
    options = {"k": 6, "widths": (8, 8, 8, 16), "raster_shape": (4, 8), "raster_width": 8}
    return build_model("adgcnn", 5, rngs=nnx.Rngs(0), shared_width=16, head=(16, 8), **options)


@pytest.fixture(scope="module")
def found(golden, network):
    """Logits, gradients and new statistics on the padded clouds, from one compiled call."""
    graphdef, params, rest = nnx.split(network, nnx.Param, ...)
    params = filled(params, named(golden, "weight"))
    posed = [golden[f"input/{name}"] for name in PosedClouds._fields]
    posed, mask = padded(posed)

    @jax.jit
    def run(params, posed):
        def loss(params, features):
            model = nnx.merge(graphdef, params, rest, copy=True)
            logits = model.classify(posed._replace(features=features), mask)
            return jnp.sum(logits * golden["cotangent"]), (logits, nnx.split(model, nnx.Param, ...)[2])

        return jax.value_and_grad(loss, argnums=(0, 1), has_aux=True)(params, posed.features)

    (_, (logits, statistics)), (of_params, of_features) = run(params, posed)
    return {"params": params, "posed": posed, "mask": mask, "logits": logits, "statistics": statistics} | {
        "of_params": of_params,
        "of_features": of_features,
    }


def close(a, b, share=2e-3):
    # Float32 against float64; batch norm over three clouds magnifies rounding a hundredfold (a variance of two degrees
    # of freedom may come out small), so the bound is a share of the array's largest entry.
    np.testing.assert_allclose(a, b, rtol=share, atol=share * max(np.abs(b).max(), 1e-3))


def test_logits_in_training(golden, found):
    close(found["logits"], golden["logits_train"])


def test_every_gradient(golden, found):
    gradients, expected = by_name(found["of_params"]), named(golden, "gradient")
    assert gradients.keys() == expected.keys()
    largest = max(np.abs(value).max() for value in expected.values())
    for name, value in expected.items():
        # Those of layers before a batch norm may cancel to nothing: held to a share of the largest gradient then.
        np.testing.assert_allclose(
            gradients[name], value, rtol=5e-3, atol=5e-3 * np.abs(value).max() + 1e-6 * largest, err_msg=name
        )
    n = golden["gradient_input"].shape[1]
    close(found["of_features"][:, :n], golden["gradient_input"], share=5e-3)
    np.testing.assert_array_equal(found["of_features"][:, n:], 0.0)


def test_running_statistics(golden, found):
    statistics, expected = by_name(found["statistics"]), named(golden, "statistic")
    assert statistics.keys() >= expected.keys()
    rows = {"layers": 3 * 48 * 6, "raster": 3 * 4 * 8, "shared": 3 * 48, "classifier": 3}
    for name, value in expected.items():
        if name.endswith(".var"):  # torch blends in the variance with divisor n - 1
            count = rows[name.split(".")[0]]
            value = 0.9 + (value - 0.9) * (count - 1) / count
        close(statistics[name], value, share=1e-3)


def test_logits_in_evaluation(golden, found, network):
    model = nnx.merge(*nnx.split(network), copy=True)
    model.eval()
    graphdef, _, _ = nnx.split(model, nnx.Param, ...)

    @jax.jit
    def run(params, rest, posed):
        return nnx.merge(graphdef, params, rest, copy=True).classify(posed, found["mask"])

    statistics = filled_statistics(nnx.split(model, nnx.Param, ...)[2], named(golden, "statistic"))
    close(run(found["params"], statistics, found["posed"]), golden["logits_eval"])


def filled_statistics(rest, values):
    return jax.tree.map_with_path(
        lambda path, leaf: jnp.asarray(values[dotted(path)]) if dotted(path) in values else leaf, rest
    )
