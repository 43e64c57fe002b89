"""What finding the cable first is worth: sizes by a cylinder fit to all points, to those kept, to the true ones, and adgcnn_fit.

    python -m experiments.train -m experiment=hard_adgcnn_fit
    python -m experiments.rejection [--runs runs] [--out results]

Every finished run, trained on `hard` clouds of 512 points alone, is tested once on test clouds of every kind; tables are
printed and kept in `<out>/rejection.json`.
"""

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from jaxtyping import Float

from cablejax.io import provenance, write_json
from cablejax.nets import ADGCNNFit, FitEstimate
from cablejax.ops import weighted_cylinder
from cablejax.simulate import Split
from cablejax.train import initialise_from
from experiments import ROOT
from experiments.analysis.results import Results
from experiments.collect import CollectError, flatten, read_records
from experiments.display.measurement.rejection_tables import arcs, ways
from experiments.harness.revision import code_revision, is_clean
from experiments.harness.runs import RECORD
from experiments.harness.schema import Config, from_flat
from experiments.material.baseline import fitted_diameters, nearest_size
from experiments.material.training import clouds_of, held_out, initial_model

TRAINED = "hard_adgcnn_fit"
CLOUDS = (("standard", 512), ("real-like", 512), ("hard", 512), ("hard", 1024))  # of the tests
BATCH = 32
ARCS_DEG = (0, 80, 100, 120, 180, 360)
CERTAIN = (0.85, 0.95)  # "called with 90 % certainty"


def estimates(model: ADGCNNFit, split: Split) -> FitEstimate:
    """What a network says of every cloud, a batch at a time."""
    graphdef, state = nnx.split(model)

    @jax.jit
    def ask(xyz: jax.Array, mask: jax.Array) -> FitEstimate:
        return nnx.merge(graphdef, state, copy=True).estimate(xyz, mask)

    total = len(split.label)
    rows = np.minimum(np.arange(-(-total // BATCH) * BATCH), total - 1).reshape(-1, BATCH)
    xyz, mask = np.asarray(split.xyz), np.asarray(split.mask)
    said = [jax.device_get(ask(xyz[each], mask[each])) for each in rows]
    return FitEstimate(*(jnp.asarray(np.concatenate(each)[:total]) for each in zip(*said, strict=True)))


def sizes_told(predicted: np.ndarray, label: np.ndarray) -> dict[str, float]:
    """Shares of clouds whose size is told rightly, and to within one size; a cloud without a fit is wrong."""
    off = np.abs(predicted - label)
    return {"accuracy": float(np.mean(off == 0)), "within_one": float(np.mean(off <= 1))}


def by_fit(split: Split, mask: np.ndarray, nominal: tuple[float, ...]) -> dict[str, float]:
    """The robust cylinder fit to the points of `mask` and the nearest nominal size."""
    fitted = fitted_diameters(split._replace(mask=jnp.asarray(mask)))
    error = np.abs(fitted - np.asarray(split.diameter_mm))
    label = np.asarray(split.label)
    predicted = np.where(fitted > 0, nearest_size(fitted, nominal), -9)
    return {**sizes_told(predicted, label), "median_error_mm": float(np.median(error))}


def most_likely(split: Split, nominal: tuple[float, ...], noise_mm: np.ndarray) -> np.ndarray:
    """The likeliest size of each cloud `[N]` by its true points, the axis fitted anew for each size.

    Residuals are taken for independent and normal, with the standard deviation that the free fit leaves.
    """

    @jax.jit
    def misfit(cloud: tuple[jax.Array, jax.Array, jax.Array]) -> jax.Array:
        xyz, weight, noise = cloud
        sized = [weighted_cylinder(xyz, weight, radius=0.5 * d).residual for d in nominal]
        return jnp.stack([jnp.sum(weight * jnp.minimum((r / noise) ** 2, 9.0)) for r in sized])

    weight = jnp.asarray(split.on_cable, jnp.float32)
    chance = jax.lax.map(misfit, (jnp.asarray(split.xyz), weight, jnp.asarray(noise_mm)))
    return np.asarray(jnp.argmin(chance, axis=1))


def arcs_deg(split: Split) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """Arc that the true points cover, degrees, and their noise in mm `[N]`, by the fit to them.

    An even arc a has unit vectors whose mean is sin(a/2) / (a/2) long.
    """

    @jax.jit
    def lies(cloud: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        fit = weighted_cylinder(*cloud)
        return fit.mean_direction, fit.noise

    weight = jnp.asarray(split.on_cable, jnp.float32)
    mean, noise = (np.asarray(each) for each in jax.lax.map(lies, (jnp.asarray(split.xyz), weight)))
    arc = np.linspace(1e-3, 2 * np.pi, 2000)
    shorter = np.sin(arc / 2) / (arc / 2)
    return np.degrees(np.interp(-mean, -shorter, arc)), noise


def reliability(logits: np.ndarray, label: np.ndarray) -> dict[str, Any]:
    """How right a network is where it is how sure: ten bins of its highest probability, and the clouds called with 90 %."""
    chance = np.asarray(jax.nn.softmax(logits, axis=1))
    sure, right = chance.max(axis=1), chance.argmax(axis=1) == label
    place = np.minimum((10 * sure).astype(int), 9)
    bins = [
        {
            "sure": float(sure[place == i].mean()),
            "right": float(right[place == i].mean()),
            "clouds": int((place == i).sum()),
        }
        for i in range(10)
        if (place == i).any()
    ]
    ninety = (sure >= CERTAIN[0]) & (sure < CERTAIN[1])
    return {
        "bins": bins,
        "expected_calibration_error": sum(b["clouds"] * abs(b["sure"] - b["right"]) for b in bins) / len(label),
        "called_90": int(ninety.sum()),
        "called_90_right": int(right[ninety].sum()),
    }


class Reference(NamedTuple):
    """What is known of test clouds without any network.

    Attributes:
        told: Accuracies by fits to all and to the true points, and by likelihood.
        likely: The likeliest size of each cloud by its true points `[N]`.
        arc: Number of the interval of `ARCS_DEG` that each cloud's arc lies in `[N]`.
    """

    told: dict[str, Any]
    likely: np.ndarray
    arc: np.ndarray


def reference(split: Split, nominal: tuple[float, ...]) -> Reference:
    """Test clouds by fits and by likelihood."""
    arc, noise = arcs_deg(split)
    likely = most_likely(split, nominal, noise)
    told = {
        "clouds": len(split.label),
        "all": by_fit(split, np.asarray(split.mask), nominal),
        "true": by_fit(split, np.asarray(split.on_cable), nominal),
        "likelihood": sizes_told(likely, np.asarray(split.label)),
    }
    return Reference(told, likely, np.digitize(arc, ARCS_DEG[1:-1]))


def tested(model: ADGCNNFit, split: Split, nominal: tuple[float, ...], known: Reference) -> dict[str, Any]:
    """A network on test clouds, beside what is known of them."""
    label, said = np.asarray(split.label), estimates(model, split)
    kept, logits = (np.asarray(said.scores) > 0) & np.asarray(split.mask), np.asarray(said.logits)
    truth, predicted = np.asarray(split.on_cable), logits.argmax(axis=1)
    return {
        **known.told,
        "kept": by_fit(split, kept, nominal),
        "adgcnn_fit": {
            **sizes_told(predicted, label),
            "median_error_mm": float(np.median(np.abs(said.diameter_mm - np.asarray(split.diameter_mm)))),
        },
        "iou_cable": float((kept & truth).sum() / (kept | truth).sum()),
        "reliability": reliability(logits, label),
        "by_arc": [
            {
                "from_deg": ARCS_DEG[i],
                "to_deg": ARCS_DEG[i + 1],
                "clouds": int(here.sum()),
                "adgcnn_fit": float((predicted == label)[here].mean()),
                "likelihood": float((known.likely == label)[here].mean()),
            }
            for i in range(len(ARCS_DEG) - 1)
            if (here := known.arc == i).any()
        ],
    }


def trained(folder: Path) -> list[tuple[Config, ADGCNNFit, dict[str, Any]]]:
    """The networks of the finished runs below a folder, each with its configuration and record.

    Raises:
        CollectError: If there is no run, or runs come from several revisions.
    """
    found = []
    for record, path in zip(read_records(folder), sorted(folder.glob(f"*/{RECORD}")), strict=True):
        cfg = from_flat(flatten(record["config"]))
        model = initialise_from(initial_model(cfg, len(cfg.dataset.sizes_mm2)), path.parent).model
        assert isinstance(model, ADGCNNFit)
        model.eval()
        found.append((cfg, model, record))
    return found


def run(runs: Path, out: Path, *, size: str, allow_dirty: bool = False) -> dict[str, Any]:
    """Test every finished run and write `<out>/rejection.json`.

    Raises:
        CollectError: If there is no run, runs come from several revisions, or code was not committed.
    """
    networks, rows = trained(runs / TRAINED / size), []
    first, _, record = networks[0]
    for revision in (record["code_revision"], code_revision()):
        if not allow_dirty and not is_clean(revision):
            raise CollectError(f"{TRAINED}: made by uncommitted code ({revision}); commit and run again")
    nominal = clouds_of(first.dataset, 1).diameters_mm
    for version, n_points in CLOUDS:
        split = held_out(replace(first, dataset=replace(first.dataset, version=version, n_points=n_points)), "test")
        known = reference(split, nominal)
        for cfg, model, _ in networks:
            print(f"{version}, {n_points} points: seed {cfg.seed}", file=sys.stderr, flush=True)
            cell = {"dataset": version, "n_points": n_points, "seed": cfg.seed}
            rows.append(cell | tested(model, split, nominal, known))
    result = {
        "experiment": "rejection",
        "size": size,
        "seeds": sorted({row["seed"] for row in rows}),
        "code_revision": code_revision(),
        "trained_by": record["code_revision"],
        "train_seconds": [round(each["metrics"]["train_seconds"], 1) for _, _, each in networks],
        "provenance": {k: v for k, v in provenance(seeds=[]).items() if k not in ("seeds", "git")},
        "config": {k: v for k, v in flatten(record["config"]).items() if k != "seed"},
        "runs": rows,
    }
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / f"{result['experiment']}.json", result)
    return result


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m experiments.rejection", description="Test the runs of adgcnn_fit.")
    parser.add_argument("--size", default="quick", choices=("smoke", "quick", "paper"))
    parser.add_argument("--runs", type=Path, default=ROOT / "runs")
    parser.add_argument("--out", type=Path, default=ROOT / "results")
    parser.add_argument("--allow-dirty", action="store_true", help="also take runs of uncommitted code")
    options = parser.parse_args()
    try:
        found = run(options.runs, options.out, size=options.size, allow_dirty=options.allow_dirty)
        print(ways(Results(found)).to_text(), arcs(Results(found)).to_text(), sep="\n\n")
    except CollectError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(1)


if __name__ == "__main__":
    main()
