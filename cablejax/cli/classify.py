"""`cablejax classify`: the nominal size that a trained network sees in a scan."""

import argparse
from typing import TYPE_CHECKING, Any, NamedTuple

from cablejax.cli.checkpoint import read_run, restored
from cablejax.cli.errors import NoResultError
from cablejax.cli.scans import load, rows, say

if TYPE_CHECKING:
    import numpy as np
    from flax import nnx

PIECES = 16  # samples of the cable whose probabilities are averaged
PIECE_MM = 150.0  # length of cable that a sample shows; training clouds show 120 to 250


class _Network(NamedTuple):
    """What tells the size, and on what clouds it learnt to."""

    network: "nnx.Module"
    model: str
    source: str
    labels: list[str]
    clouds: dict[str, Any]
    accuracy: float


def _record_of(folder: str) -> dict[str, Any]:
    """The record of a run of `experiments.train`.

    Raises:
        NoResultError: If it is none, or does not say which network was trained.
    """
    record = read_run(folder, trained="classifier", by="experiments.train", holds="labels_mm2")
    config = record.get("config")
    if not isinstance(config, dict) or not {"model", "dataset"} <= set(config):
        raise NoResultError(
            f"--checkpoint {folder}: its run.json is damaged: it does not say which network was trained"
        )
    return record


def _of_run(folder: str, record: dict[str, Any]) -> _Network:
    """The network of a run."""
    from flax import nnx

    from cablejax.nets import build_model

    config, metrics = record["config"], record["metrics"]
    labels, options = metrics["labels_mm2"], dict(config["model"]["options"])
    if config["model"]["name"] == "adgcnn_fit":
        options["diameters_mm"] = _diameters(labels)
    network = build_model(config["model"]["name"], len(labels), rngs=nnx.Rngs(0), **options)
    return _Network(
        restored(folder, network),
        config["model"]["name"],
        folder,
        labels,
        config["dataset"],
        metrics["test_overall"],
    )


def _diameters(labels: list[str]) -> list[float]:
    """Diameters of the catalogue that the training clouds are made of."""
    from cablejax.simulate import DatasetConfig

    return list(DatasetConfig(sizes_mm2=tuple(float(label) for label in labels)).diameters_mm)


def _of_package(name: str) -> _Network:
    """A network that comes with the package."""
    from cablejax.nets import WeightsError, load_pretrained

    try:
        network, card = load_pretrained(name)
    except WeightsError as error:
        raise NoResultError(str(error).replace("name: ", "--network: ", 1)) from None
    if "length_mm" not in card["clouds"]:
        raise NoResultError(f"--network: expected one that tells sizes, got {name!r}: {card['about']}")
    source = f"cablejax.nets.load_pretrained({name!r})"
    return _Network(network, card["model"], source, card["classes"], card["clouds"], card["accuracy"]["test"])


def _pieces(xyz: "np.ndarray", along: "np.ndarray", clouds: dict[str, Any], seed: int):
    """Random samples of stretches of the cable, posed as the training clouds were: `[PIECES, n, 3]`."""
    import jax
    import jax.numpy as jnp
    import numpy as np

    from cablejax.simulate.pose import canonical_pose, centred

    rng, n = np.random.default_rng(seed), clouds["n_points"]
    drawn = []
    for _ in range(PIECES):
        start = rng.uniform(along.min(), max(along.max() - PIECE_MM, along.min()))
        here = np.flatnonzero((along >= start) & (along <= start + PIECE_MM))
        here = here if len(here) >= n else np.argsort(np.abs(along - start - PIECE_MM / 2))[: max(n, len(here))]
        drawn.append(xyz[rng.choice(here, size=n, replace=len(here) < n)])
    stacked = np.stack(drawn)
    stacked = (stacked - stacked.mean(axis=1, keepdims=True)).astype(np.float32)
    mask = jnp.ones(stacked.shape[:2], dtype=bool)
    return jax.vmap(canonical_pose if clouds["canonical_pose"] else centred)(jnp.asarray(stacked), mask), mask


def run(options: argparse.Namespace) -> dict[str, Any]:
    """Find the cable, sample it, average the network's probabilities over the samples."""
    record = None if options.checkpoint is None else _record_of(options.checkpoint)
    scan = load(options, options.scan)
    told = _of_package(options.network) if record is None else _of_run(str(options.checkpoint), record)
    import jax
    import numpy as np

    from cablejax.measure import MeasureError, measure_cable

    say(options, f"looking for the cable in {len(scan.xyz_mm):,} points")
    try:
        measured = measure_cable(scan.xyz_mm)
    except MeasureError as error:
        raise NoResultError(f"{options.scan}: {error}") from None
    say(options, f"classifying by {told.source}")
    xyz, along = scan.xyz_mm[measured.keep], measured.along_mm[measured.keep]
    logits = np.asarray(jax.jit(told.network)(*_pieces(xyz, along, told.clouds, options.seed)))
    chance = np.asarray(jax.nn.softmax(logits, axis=1)).mean(axis=0)
    order = np.argsort(-chance)
    return {
        "file": str(scan.path),
        "network": told.source,
        "model": told.model,
        "test_accuracy": told.accuracy,
        "size_mm2": told.labels[order[0]],
        "probabilities": {told.labels[i]: float(chance[i]) for i in order},
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
