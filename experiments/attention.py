"""Where channel attention looks: the weights of eq. (12) in a trained ADGCNN, and what they mean on the surface.

    python -m experiments.attention RUN [--out results]

RUN is the folder of a finished run of `experiments.train model=adgcnn`. One test cloud of the smallest, the middle and the
largest size is written with its weights to `<out>/attention.json`. Nothing is trained.
"""

import argparse
import sys
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jaxtyping import Array, Bool, Float

from cablejax.io import read_json, write_json
from cablejax.nets.adgcnn import ADGCNN
from cablejax.nets.aedgeconv import AEdgeConv
from cablejax.nets.input_channels import pose_clouds
from experiments.collect import flatten
from experiments.harness import schema
from experiments.harness.revision import code_revision
from experiments.harness.runs import RECORD
from experiments.material.training import clouds_of, fitted, held_out

TINY = 1e-12  # below every response: keeps a silent channel or point from dividing by zero


class LayerAttention(NamedTuple):
    """The attention of one layer.

    Attributes:
        channels: Weight of each channel in each cloud, between 0 and 1 `[b, d]`.
        points: At each point the mean of these weights, each channel counted by its response there `[b, n]`.
        features: What the layer gives to the next `[b, n, d]`.
    """

    channels: Float[Array, "b d"]
    points: Float[Array, "b n"]
    features: Float[Array, "b n d"]


def layer_attention(layer: AEdgeConv, x: Float[Array, "b n c"], mask: Bool[Array, "b n"]) -> LayerAttention:
    """The layer's output with and without attention; their ratio is the weight, since a positive factor passes through
    LeakyReLU and the maximum over neighbours.

    Raises:
        ValueError: If the layer has no attention.
    """
    attention = layer.attention
    if attention is None:
        raise ValueError("layer: expected one with channel attention, got one without")
    weighted = layer(x, mask)
    layer.attention = None
    plain = jnp.abs(layer(x, mask))
    layer.attention = attention
    channels = jnp.sum(jnp.abs(weighted), axis=1) / jnp.maximum(jnp.sum(plain, axis=1), TINY)
    points = jnp.sum(jnp.abs(weighted), axis=2) / jnp.maximum(jnp.sum(plain, axis=2), TINY)
    return LayerAttention(channels, points, weighted)


def attention_of(model: ADGCNN, xyz: Float[Array, "b n 3"], mask: Bool[Array, "b n"]) -> list[LayerAttention]:
    """The attention of every layer of a network in evaluation, for clouds in mm."""
    model = nnx.clone(model)
    model.eval()
    x, layers = pose_clouds(xyz, mask, pose=model.pose, scale_mm=model.scale_mm).features, []
    for layer in model.layers:
        layers.append(layer_attention(layer, x, mask))
        x = layers[-1].features
    return layers


def written(record: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The content of the results file for a finished run."""
    cfg = schema.from_flat({**flatten(record["config"]), "out": str(folder.parent)})
    model = fitted(cfg, folder).model
    assert isinstance(model, ADGCNN)
    split = held_out(cfg, "test")
    label = np.asarray(split.label)
    classes = [0, len(cfg.dataset.sizes_mm2) // 2, len(cfg.dataset.sizes_mm2) - 1]
    rows = np.array([np.flatnonzero(label == each)[0] for each in classes])
    xyz, mask = jnp.asarray(split.xyz)[rows], jnp.asarray(split.mask)[rows]
    layers = attention_of(model, xyz, mask)
    posed = pose_clouds(xyz, mask, pose="cylinder", scale_mm=1.0)
    logits = jax.nn.softmax(model(xyz, mask))
    diameters = clouds_of(cfg.dataset, 1).diameters_mm
    clouds = []
    for i, size in enumerate(classes):
        seen = np.asarray(mask[i])
        clouds.append({
            "size_mm2": cfg.dataset.sizes_mm2[size],
            "diameter_mm": round(float(diameters[size]), 2),
            "probability": round(float(logits[i, size]), 4),
            "along_mm": np.round(np.asarray(posed.axial[i])[seen], 2).tolist(),
            "angle_deg": np.round(np.degrees(np.asarray(posed.angle[i])[seen]), 1).tolist(),
            "points": [np.round(np.asarray(layer.points[i])[seen], 4).tolist() for layer in layers],
            "channels": [np.round(np.asarray(layer.channels[i]), 4).tolist() for layer in layers],
        })  # fmt: skip
    kept = ("size", "seed", "provenance")
    return {"experiment": "attention", "code_revision": code_revision(), "clouds": clouds,
            "run": {key: record[key] for key in ("experiment", "code_revision")},
            "config": flatten(record["config"]), **{key: record[key] for key in kept}}  # fmt: skip


def main() -> None:
    """Write the attention of a run."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.attention", description="Attention of a trained ADGCNN."
    )
    parser.add_argument("run", type=Path, help="folder of a finished run of experiments.train model=adgcnn")
    parser.add_argument("--out", type=Path, default=Path("results"))
    options = parser.parse_args()
    path = options.run / RECORD
    if not path.is_file() or read_json(path)["config"]["model"]["name"] != "adgcnn":
        print(f"error: run: expected the folder of a finished run of model=adgcnn, got {options.run}", file=sys.stderr)
        sys.exit(2)
    options.out.mkdir(parents=True, exist_ok=True)
    write_json(options.out / "attention.json", written(read_json(path), options.run))
    print(options.out / "attention.json")


if __name__ == "__main__":
    main()
