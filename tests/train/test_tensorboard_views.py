"""What a run shows in TensorBoard beside its curves."""

import numpy as np
import pytest
from flax import nnx

from cablejax.io import RunLogger
from cablejax.train import fit
from tests.io.test_tensorboard import events, values
from tests.train.tiny import Tiny, settings, split


class Attentive(Tiny):
    def attention_weights(self, xyz, mask):
        return [xyz[:, :4, 0] * 0 + 0.25, xyz[:, :2, 0] * 0 + 0.5]


@pytest.mark.parametrize("network", [Tiny, Attentive])
def test_attention_of_every_layer_and_epoch_and_a_mesh_of_a_batch(tmp_path, network):
    with RunLogger(tmp_path) as log:
        fit(network(nnx.Rngs(0)), split(), split(12, seed=1), settings(epochs=2), logger=log, progress=False)
    found = values(tmp_path, "attention/layer1"), values(tmp_path, "attention/layer2")
    if network is Tiny:
        assert found == ([], [])
    else:
        assert [[step for step, _ in layer] for layer in found] == [[1, 2], [1, 2]]
        assert [layer[0][1].histo.num for layer in found] == [8 * 4, 8 * 2]
        assert np.isclose(found[1][0][1].histo.min, 0.5)
    meshes = [v.tag for e in events(tmp_path) for v in e.summary.value if v.metadata.plugin_data.plugin_name == "mesh"]
    assert len(meshes) == 2  # vertices and colours
    assert all(tag.startswith("train/clouds") for tag in meshes)
