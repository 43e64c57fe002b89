"""The attention that is drawn is that of eq. (12), and a run's results file holds it for three sizes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx

from cablejax.io import write_json
from cablejax.nets.aedgeconv import AEdgeConv
from cablejax.ops.edges import channel_attention, edge_products
from cablejax.ops.feature_graph import feature_graph
from cablejax.report import figure_style
from experiments.analysis.results import Results
from experiments.attention import layer_attention
from experiments.display.networks import attention


def test_channel_weights_are_those_of_equation_12():
    layer = AEdgeConv(3, 8, k=4, rngs=nnx.Rngs(0))
    layer.eval()
    x = jax.random.normal(jax.random.key(1), (1, 24, 3))
    mask = jnp.ones((1, 24), bool)
    ours = layer_attention(layer, x, mask)
    graph = feature_graph(x[0], k=4, mask=mask[0])
    center, neighbor = edge_products(x[0], layer.kernel[...])
    scale, shift = layer.norm.fold(layer.norm.mean[...], layer.norm.var[...])
    edges = (center[:, None, :] + neighbor[graph]) * scale[None, None] + shift[None, None]
    assert layer.attention is not None
    expected = channel_attention(edges, graph >= 0, layer.attention.weights())
    np.testing.assert_allclose(ours.channels[0], expected, rtol=1e-4)
    assert float(expected.max() - expected.min()) > 0.01  # not all alike, or the comparison would say little
    assert np.all((ours.points >= float(expected.min()) - 1e-4) & (ours.points <= float(expected.max()) + 1e-4))


def test_layer_without_attention_is_refused():
    layer = AEdgeConv(3, 8, k=4, attention=False, rngs=nnx.Rngs(0))
    with pytest.raises(ValueError, match="layer: expected one with channel attention"):
        layer_attention(layer, jnp.zeros((1, 24, 3)), jnp.ones((1, 24), bool))


def test_figure_has_a_row_for_each_cloud_and_a_column_for_each_layer(tmp_path):
    rng = np.random.default_rng(0)
    cloud = {"size_mm2": 25.0, "along_mm": [0.0, 1.0], "angle_deg": [0.0, 90.0],
             "points": rng.random((4, 2)).tolist(), "channels": rng.random((4, 8)).tolist()}  # fmt: skip
    config = {"optimizer.name": "adadelta", "training.epochs": 6}
    run = {"experiment": "fig8_adgcnn"}
    write_json(tmp_path / "attention.json", {"clouds": [cloud, cloud], "run": run, "config": config, "size": "smoke"})
    results = Results.read(tmp_path, "attention")
    assert results is not None
    with figure_style():
        axes = attention.surface(results).figure.axes
    assert len([ax for ax in axes if ax.get_label() != "<colorbar>"]) == 3 * 4
