"""Put a trained network into the package: weights, card, and the sample by which a test knows it again.

    python -m experiments.publish adgcnn_fit runs/hard_adgcnn_fit/quick/...

Weights and card go to `cablejax/nets/weights`, the sample to `tests/golden/pretrained_<name>.npz`. The accuracy on the card is
that of the weights as stored, on the run's own test clouds.
"""

import argparse
import hashlib
import io
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from flax import nnx

from cablejax.io import atomic_write, read_json, write_json
from cablejax.nets.pretrained import LICENCE, arrays_of, calibrated, filled, network_of
from cablejax.simulate import PartSplit, Split
from cablejax.simulate.clouds import VERSIONS
from cablejax.simulate.part_scenes import diameters_mm
from cablejax.train import evaluate, initialise_from
from cablejax.train.metrics import predict
from experiments import ROOT, parts
from experiments.analysis.inference import wilson
from experiments.calibration import calibration_clouds, logits_of, temperature_of
from experiments.collect import CollectError, flatten
from experiments.harness.revision import is_clean
from experiments.harness.runs import RECORD
from experiments.harness.schema import Config, from_flat
from experiments.material.training import fitted_options, held_out
from experiments.pretrain import RADIUS_MM, modelnet

WEIGHTS = ROOT / "cablejax" / "nets" / "weights"
GOLDEN = ROOT / "tests" / "golden"
SAMPLE = {"classifier": 39, "parts": 8, "backbone": 13}  # clouds by which a test knows the network again


@dataclass(frozen=True)
class Published:
    """A network of the package.

    Attributes:
        kind: "classifier", "parts" or "backbone".
        module: Whose run trains it.
        about: What it does, in a sentence.
        limits: What it is not made for.
        calibrated: Whether a temperature is fitted on validation clouds.
        data: What it was trained on.
    """

    kind: str
    module: str
    about: str
    limits: str
    calibrated: bool = False
    data: str = "made by the simulator of this package; nothing of another maker"


PUBLISHED = {
    "adgcnn": Published(
        "classifier",
        "experiments.train",
        "ADGCNN (Su et al. 2025, section III.A): the nominal size of a piece of cable seen by itself, by at least half of "
        "its circumference.",
        "Simulated clouds alone were seen in training: 8.7/15 kV single-core cables of 25 to 630 mm2, arcs of 180 to 360 "
        "degrees, range noise of 0.1 mm, no wall and no other cable beside. On such clouds a plain cylinder fit is as good.",
    ),
    "adgcnn_fit": Published(
        "classifier",
        "experiments.train",
        "Edge convolutions that score the points, a cylinder fitted to the cable's, and the nominal size from both: for short "
        "arcs with noise, beside walls and other cables.",
        "Simulated clouds alone were seen in training: 8.7/15 kV single-core cables of 25 to 630 mm2, arcs of 60 to 120 "
        "degrees, range noise of 0.3 to 0.6 mm, 120 to 250 mm of cable that is the longest thing in the cloud.",
        calibrated=True,
    ),
    "parts": Published(
        "parts",
        "experiments.parts",
        "Labels each point of a ball of 250 mm of a scan: cable, stray, accessory, fitting or surroundings.",
        "Simulated scenes alone were seen in training, with cables of 10 to 60 mm: what is thicker is taken for surroundings or "
        "stray. A joint's barrel by itself looks like a thicker cable, and which of two cables is meant no label can tell.",
    ),
    "modelnet10": Published(
        "backbone",
        "experiments.pretrain",
        "ADGCNN's edge convolutions trained to tell the ten classes of ModelNet10 apart: a backbone to start networks "
        "for other clouds from.",
        "Sampled from meshes, without noise or occlusion; each cloud centred and scaled to a radius of 60 mm.",
        data="ModelNet10's official training clouds (Wu et al. 2015), which are for academic research: what was learnt from them "
        "should be used likewise",
    ),
}


def publish(name: str, folder: Path, *, weights: Path = WEIGHTS, golden: Path = GOLDEN) -> dict[str, Any]:
    """Write the three files of a network.

    Args:
        name: One of `PUBLISHED`.
        folder: Of the finished run.
        weights: Where weights and card go.
        golden: Where the sample goes.

    Returns:
        The card.

    Raises:
        CollectError: If the folder holds no finished run of committed code.
    """
    record = _record(folder)
    if not is_clean(record["code_revision"]):
        raise CollectError(f"{folder}: made by uncommitted code ({record['code_revision']}); commit and run again")
    cfg, this = from_flat(flatten(record["config"])), PUBLISHED[name]
    described, test = DESCRIBED[this.kind](cfg, record["metrics"])
    trained = initialise_from(network_of(described), folder)
    if trained.kept:
        raise CollectError(f"{folder}: holds nothing that fits {trained.kept[0]} of the network")
    arrays = arrays_of(trained.model)
    stored, data = filled(network_of(described), arrays, source=name), _archive(arrays)
    if this.calibrated:
        validation = calibration_clouds(cfg)
        temperature = temperature_of(logits_of(stored, validation), np.asarray(validation.label))
        described |= {"temperature": temperature, "calibrated_on": f"{len(validation.label)} validation clouds"}
        stored = calibrated(stored, described)
    card = {
        "name": name,
        "about": this.about,
        **described,
        "accuracy": _accuracy(stored, test, this.kind),
        "seed": cfg.seed,
        "seeds": _seeds(record, folder, described, test),
        "limits": this.limits,
        "data": this.data,
        "command": f"python -m {this.module} experiment={cfg.name} size={cfg.size} seed={cfg.seed}",
        "code_revision": record["code_revision"],
        "licence": LICENCE,
        "bytes": len(data),
        "sha256": hashlib.sha256(data).hexdigest(),
    }
    weights.mkdir(parents=True, exist_ok=True)
    with atomic_write(weights / f"{name}.npz") as file:
        file.write(data)
    write_json(weights / f"{name}.json", card)
    _write_sample(
        golden / f"pretrained_{name}.npz",
        stored,
        _samples(cfg, test, this.kind),
        SAMPLE[this.kind],
        own=this.kind != "backbone",
    )
    return card


def _record(folder: Path) -> dict[str, Any]:
    """The record of a finished run.

    Raises:
        CollectError: If there is none.
    """
    try:
        return read_json(folder / RECORD)
    except (OSError, ValueError):
        raise CollectError(f"{folder}: no finished run") from None


def _classifier(cfg: Config, metrics: dict[str, Any]) -> tuple[dict[str, Any], Split]:
    """What the card says of a network that tells sizes, and its test clouds."""
    version = VERSIONS[cfg.dataset.version]
    clouds = {
        "version": cfg.dataset.version,
        "n_points": cfg.dataset.n_points,
        "canonical_pose": cfg.dataset.canonical_pose,
        **{key: list(getattr(version, key)) for key in ("arc_deg", "noise_mm", "length_mm")},
    }
    options = {**cfg.model.options, **fitted_options(cfg)}
    card = {"model": cfg.model.name, "options": options, "classes": metrics["labels_mm2"], "clouds": clouds}
    return card, held_out(cfg, "test")


def _labeller(cfg: Config, metrics: dict[str, Any]) -> tuple[dict[str, Any], PartSplit]:
    """What the card says of a network that labels points, and its test clouds."""
    clouds = {
        "mix": cfg.parts.mix,
        "n_points": cfg.parts.n_points,
        "ball_mm": cfg.parts.ball_mm,
        "train": cfg.parts.train,
        "diameter_mm": list(diameters_mm(wide=cfg.parts.mix == "wide")),
    }
    card = {"model": "parts", "options": dict(cfg.model.options), "classes": metrics["parts"], "clouds": clouds}
    return card, parts.clouds(cfg, "test")


def _backbone(cfg: Config, metrics: dict[str, Any]) -> tuple[dict[str, Any], Split]:
    """What the card says of a network that was trained on ModelNet10, and the tenth that was held out for its test."""
    clouds = {"n_points": cfg.dataset.n_points, "radius_mm": RADIUS_MM, "train": metrics["train_clouds"]}
    options = {**cfg.model.options, "pose": "none"}
    card = {"model": cfg.model.name, "options": options, "classes": metrics["classes"], "clouds": clouds}
    return card, modelnet(cfg.dataset.n_points, cfg.seed, held_out=2)[1][1]


DESCRIBED = {"classifier": _classifier, "parts": _labeller, "backbone": _backbone}


def _accuracy(network: nnx.Module, test: Split | PartSplit, kind: str) -> dict[str, Any]:
    """Share that is right of the test clouds, or of their points, with its interval."""
    found = evaluate(network, test)
    if kind == "parts":
        scored, interval = parts.scores(found), _over_clouds(network, test)
        told = {"test": found.overall, "interval_95": interval, "clouds": len(test.label)}
        return told | {"mean_iou": scored["mean_iou"], "iou": scored["iou"]}
    right, count = int(np.trace(found.confusion)), int(found.confusion.sum())
    share = wilson(right, count)
    return {"test": share.value, "interval_95": [share.low, share.high], "clouds": count}


def _over_clouds(network: nnx.Module, test: Split | PartSplit) -> list[float]:
    """The 95 % interval of the share of points told rightly: bootstrap over clouds, for the points of one are not independent."""
    graphdef, state = nnx.split(network)
    said, mask = predict(graphdef, state, test, batch_size=32)[0].argmax(axis=-1), np.asarray(test.mask)
    right, count = ((said == np.asarray(test.label)) & mask).sum(axis=1), mask.sum(axis=1)
    drawn = np.random.default_rng(0).integers(len(count), size=(2000, len(count)))
    return np.quantile(right[drawn].sum(axis=1) / count[drawn].sum(axis=1), (0.025, 0.975)).tolist()


def _seeds(
    record: dict[str, Any], folder: Path, described: dict[str, Any], test: Split | PartSplit
) -> dict[str, float]:
    """Test accuracy of all seeds of the same experiment, by seed, by the code of today."""
    found = {}
    for path in folder.parent.glob(f"*/{RECORD}"):
        other = _record(path.parent)
        if {**other["config"], "seed": 0} == {**record["config"], "seed": 0}:
            network = initialise_from(network_of(described), path.parent).model
            found[str(other["seed"])] = evaluate(network, test).overall
    return dict(sorted(found.items()))


def _archive(arrays: dict[str, np.ndarray]) -> bytes:
    """The arrays as a compressed `.npz`.

    Raises:
        CollectError: If a weight is too large for half precision.
    """
    wild = [name for name, array in arrays.items() if not np.isfinite(array).all()]
    if wild:
        raise CollectError(f"{wild[0]}: expected finite weights within 65,504")
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)  # pyright: ignore[reportArgumentType]
    return buffer.getvalue()


def _samples(cfg: Config, test: Split | PartSplit, kind: str) -> Split | PartSplit:
    """Clouds by which a test knows a network again: test clouds, or where those are another's pieces of cable."""
    return (
        held_out(replace(cfg, dataset=replace(cfg.dataset, test_per_class=1)), "test") if kind == "backbone" else test
    )


def _write_sample(path: Path, network: nnx.Module, test: Split | PartSplit, count: int, *, own: bool) -> None:
    """The first clouds with what the stored weights say of them; labels are theirs where the classes are the network's `own`."""
    head = test._replace(**{key: each[:count] for key, each in test._asdict().items() if each is not None})
    graphdef, state = nnx.split(network)
    logits = predict(graphdef, state, head, batch_size=count)[0]
    xyz, mask, label = (np.asarray(each) for each in (head.xyz, head.mask, head.label))
    label = label if own else logits.argmax(axis=-1).astype(label.dtype)
    np.savez_compressed(path, xyz=xyz, mask=mask, label=label, logits=logits.astype(np.float32))


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.publish", description="Put a network into the package."
    )
    parser.add_argument("name", choices=tuple(PUBLISHED))
    parser.add_argument("run", type=Path, help="folder of a finished run")
    options = parser.parse_args()
    try:
        card = publish(options.name, options.run)
    except (CollectError, OSError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(1)
    print(f"{options.name}: {card['bytes']:,} bytes, {card['accuracy']}")


if __name__ == "__main__":
    main()
