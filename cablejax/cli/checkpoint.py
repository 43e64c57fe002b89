"""Networks that a run of the experiments left, for the commands that use one."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cablejax.cli.errors import NoResultError
from cablejax.cli.scans import say

if TYPE_CHECKING:
    import numpy as np
    from flax import nnx

    from cablejax.io import PointFile
    from cablejax.measure import PointLabels

LABELLER = "parts"  # of the package
LABELLER_CARD = f"nets/weights/{LABELLER}.json"


def read_run(folder: str, *, trained: str, by: str, holds: str) -> dict[str, Any]:
    """The record of a finished run.

    Args:
        folder: As given to `--checkpoint`.
        trained: What a run must have trained, in words.
        by: The experiment that does.
        holds: What the metrics of such a run hold, and others do not.

    Raises:
        NoResultError: If the folder holds no finished run, or one that trained something else.
    """
    from cablejax.io import read_json

    record = Path(folder) / "run.json"
    if not record.is_file():
        raise NoResultError(f"--checkpoint {folder}: no run.json; give the folder of a finished run of {by}")
    try:
        found = read_json(record)
    except (OSError, ValueError):
        raise NoResultError(f"--checkpoint {folder}: its run.json is damaged or cannot be read") from None
    metrics = found.get("metrics") if isinstance(found, dict) else None
    if not isinstance(metrics, dict) or holds not in metrics:
        raise NoResultError(f"--checkpoint {folder}: this run trained no {trained}; give one of {by}")
    return found


def restored(folder: str, model: "nnx.Module") -> "nnx.Module":
    """The network with the weights of the run, those that were best on validation, in evaluation mode.

    Raises:
        NoResultError: If the folder holds no whole checkpoint of that network.
    """
    from cablejax.train import initialise_from

    try:
        found = initialise_from(model, folder)
    except ValueError as error:
        raise NoResultError(f"--checkpoint {folder}: {str(error).removeprefix('init_from: ')}") from None
    if found.kept:
        raise NoResultError(f"--checkpoint {folder}: holds nothing that fits {found.kept[0]} of the network")
    found.model.eval()
    return found.model


def labels_of_package(options: argparse.Namespace, scan: "PointFile") -> "tuple[np.ndarray, PointLabels]":
    """The part that each point lies on by the labeller of the package, and what a measurement takes of it.

    Raises:
        NoResultError: If its files are damaged.
    """
    import numpy as np

    from cablejax.measure import PointLabels
    from cablejax.nets import WeightsError, label_parts, load_pretrained

    try:
        network, card = load_pretrained(LABELLER)
    except WeightsError as error:
        raise NoResultError(f"--labels: {error}") from None
    say(options, f"labelling {len(scan.xyz_mm):,} points")
    clouds = card["clouds"]
    found = label_parts(network, scan.xyz_mm, n_points=clouds["n_points"], ball_mm=clouds["ball_mm"], seed=options.seed)
    part = np.array(card["classes"])[found.part]
    low, high = clouds["diameter_mm"]
    return part, PointLabels(part == "cable", part == "accessory", (low, high))


def parts_of(options: argparse.Namespace, scan: "PointFile") -> "np.ndarray | None":
    """The part that each point lies on, by the network of `--checkpoint`; None without one."""
    if options.checkpoint is None:
        return None
    record = read_run(options.checkpoint, trained="network that labels parts", by="experiments.parts", holds="parts")
    import numpy as np
    from flax import nnx

    from cablejax.nets import PartNetwork, label_parts

    config, names = record["config"], record["metrics"]["parts"]
    network = PartNetwork(len(names), rngs=nnx.Rngs(0), **config["model"]["options"])
    say(options, f"labelling {len(scan.xyz_mm):,} points")
    clouds = {"n_points": config["parts"]["n_points"], "ball_mm": config["parts"]["ball_mm"]}
    found = label_parts(restored(options.checkpoint, network), scan.xyz_mm, **clouds, seed=options.seed)
    return np.array(names)[found.part]
