"""`cablejax classify`: the nominal size that a trained network sees in a scan."""

import argparse
from typing import TYPE_CHECKING, Any

from cablejax.cli.checkpoint import read_run, restored
from cablejax.cli.errors import NoResultError
from cablejax.cli.scans import load, rows, say

if TYPE_CHECKING:
    import numpy as np

PIECES = 16  # samples of the cable whose logits are averaged
PIECE_MM = 100.0  # length of cable that a training cloud shows


def _network(folder: str, record: dict[str, Any]):
    """The network of a run of `experiments.train`."""
    from flax import nnx

    from cablejax.nets import build_model

    config = record["config"]
    classes = len(config["dataset"]["sizes_mm2"])
    return restored(
        folder, build_model(config["model"]["name"], classes, rngs=nnx.Rngs(0), **config["model"]["options"])
    )


def _pieces(xyz: "np.ndarray", along: "np.ndarray", dataset: dict[str, Any], seed: int):
    """Random samples of stretches of the cable, posed as the training clouds were: `[PIECES, n, 3]`."""
    import jax
    import jax.numpy as jnp
    import numpy as np

    from cablejax.simulate.pose import canonical_pose, centred

    rng, n = np.random.default_rng(seed), dataset["n_points"]
    clouds = []
    for _ in range(PIECES):
        start = rng.uniform(along.min(), max(along.max() - PIECE_MM, along.min()))
        here = np.flatnonzero((along >= start) & (along <= start + PIECE_MM))
        here = here if len(here) >= n else np.argsort(np.abs(along - start - PIECE_MM / 2))[: max(n, len(here))]
        clouds.append(xyz[rng.choice(here, size=n, replace=len(here) < n)])
    stacked = np.stack(clouds)
    stacked = (stacked - stacked.mean(axis=1, keepdims=True)).astype(np.float32)
    mask = jnp.ones(stacked.shape[:2], dtype=bool)
    return jax.vmap(canonical_pose if dataset["canonical_pose"] else centred)(jnp.asarray(stacked), mask), mask


def run(options: argparse.Namespace) -> dict[str, Any]:
    """Find the cable, sample it, average the network's probabilities over the samples."""
    folder = options.checkpoint
    record = read_run(folder, trained="classifier", by="experiments.train", holds="labels_mm2")
    scan = load(options, options.scan)
    import jax
    import numpy as np

    from cablejax.measure import MeasureError, measure_cable

    model = _network(folder, record)
    say(options, f"looking for the cable in {len(scan.xyz_mm):,} points")
    try:
        measured = measure_cable(scan.xyz_mm)
    except MeasureError as error:
        raise NoResultError(f"{options.scan}: {error}") from None
    xyz, along = scan.xyz_mm[measured.keep], measured.along_mm[measured.keep]
    clouds, mask = _pieces(xyz, along, record["config"]["dataset"], options.seed)
    logits = np.asarray(model(clouds, mask))
    chance = np.asarray(jax.nn.softmax(logits, axis=1)).mean(axis=0)
    order = np.argsort(-chance)
    labels = record["metrics"]["labels_mm2"]
    return {
        "file": str(scan.path),
        "checkpoint": folder,
        "model": record["config"]["model"]["name"],
        "test_accuracy": record["metrics"]["test_overall"],
        "size_mm2": labels[order[0]],
        "probabilities": {labels[i]: float(chance[i]) for i in order},
        "measured_diameter_mm": measured.diameter_mm,
    }


def table(result: dict[str, Any]) -> str:
    """The result for reading."""
    pairs = [
        ("size", f"{result['size_mm2']} mm2, by {result['model']}"),
        ("accuracy of the network", f"{100 * result['test_accuracy']:.1f} % on its own test clouds"),
        ("diameter measured", f"{result['measured_diameter_mm']:.3f} mm"),
        *((f"{name} mm2", f"{100 * p:.1f} %") for name, p in result["probabilities"].items() if p >= 0.001),
    ]
    return "\n".join([result["file"], rows(pairs)])
