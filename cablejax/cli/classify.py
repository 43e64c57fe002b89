"""`cablejax classify`: the nominal size that a trained network sees in a scan."""

import argparse
from typing import TYPE_CHECKING, Any, NamedTuple

from cablejax.cli.arguments import add_scan
from cablejax.cli.checkpoint import read_run, restored
from cablejax.cli.errors import NoResultError
from cablejax.cli.scans import load, rows, say

if TYPE_CHECKING:
    from flax import nnx


HELP = "the nominal size that a trained network sees in a scan"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of the command."""
    add_scan(parser)
    network = parser.add_mutually_exclusive_group()
    network.add_argument(
        "--network", default="adgcnn_fit", metavar="NAME", help="one that comes with the package (default: adgcnn_fit)"
    )
    network.add_argument("--checkpoint", metavar="FOLDER", help="of a run of experiments.train, whose network to take")
    parser.add_argument("--seed", type=int, default=0, help="of the samples that the network sees (default: 0)")


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


def run(options: argparse.Namespace) -> dict[str, Any]:
    """Find the cable, sample it, average the network's probabilities over the samples."""
    record = None if options.checkpoint is None else _record_of(options.checkpoint)
    scan = load(options, options.scan)
    told = _of_package(options.network) if record is None else _of_run(str(options.checkpoint), record)
    import numpy as np

    from cablejax.measure import MeasureError, measure_cable
    from cablejax.train import classify_cable

    say(options, f"looking for the cable in {len(scan.xyz_mm):,} points")
    try:
        measured = measure_cable(scan.xyz_mm)
    except MeasureError as error:
        raise NoResultError(f"{options.scan}: {error}") from None
    say(options, f"classifying by {told.source}")
    xyz, along = scan.xyz_mm[measured.keep], measured.along_mm[measured.keep]
    clouds = told.clouds
    chance = classify_cable(
        told.network, xyz, along, n_points=clouds["n_points"], canonical=clouds["canonical_pose"], seed=options.seed
    )
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
