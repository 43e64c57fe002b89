"""Tables of networks: Figures 5-12 in numbers, the ablation, robustness, hard clouds."""

from experiments.analysis import paper
from experiments.analysis.results import NAMES, Results
from experiments.analysis.statistics import estimate, fluctuation
from experiments.display.table import Table, told

NETWORKS = ("fig5_alexnet", "fig6_vgg16", "fig7_resnet50", "fig8_adgcnn")
VARIANTS = {
    "full": "as it is",
    "no_attention": "without channel attention [eq. (12)]",
    "no_enhancement": "without feature enhancement",
    "no_fusion": "without feature fusion",
    "no_raster": "without enhancement and fusion",
    "k5": "5 neighbours",
    "k20": "20 neighbours",
    "points128": "128 points",
    "points512": "512 points",
    "filtered": "filtered clouds",
    "pose_none": "no radius of a fit among the points' channels",
}


def networks(found: dict[str, Results]) -> Table:
    """Figures 5-12 in numbers: accuracy and the fluctuation of the loss, network beside network."""
    rows = []
    for results in found.values():
        rough = {
            metric: estimate([fluctuation([epoch[metric] for epoch in row["history"]]) for row in results.rows()])
            for metric in ("train_loss", "validation_loss")
        }
        rows.append(
            [
                NAMES[results.config("model.name")],
                results.mean("test_overall").format(3),
                results.mean("test_class_average").format(3),
                fitted(results),
                rough["train_loss"].format(4),
                rough["validation_loss"].format(3),
                f"{results.config('training.epochs')}",
                f"{results.rows()[0]['learning_rate']:g}",
                f"{results.least('train_seconds'):.0f}",
            ]
        )
    each = "; ".join(f"{NAMES[r.config('model.name')]} {clouds_told(r)}, {told(r)}" for r in found.values())
    return Table(
        "Figures 5-12: the networks under Adadelta",
        [
            "Network",
            "accuracy [eq. (20)]",
            "class average [eq. (21)]",
            "cylinder fit",
            "fluctuation, training (nats)",
            "fluctuation, validation (nats)",
            "epochs",
            "rate",
            "train (s)",
        ],
        rows,
        f"Test accuracy at the epoch best on validation. {each}. Cylinder fit: accuracy of the nearest nominal size to the "
        "diameter of a cylinder fitted to the same clouds, with no network. Fluctuation: root mean square of the loss about its "
        "mean over three epochs, over the second half of the run. The image networks see a depth image of the same clouds. The "
        f"paper shows curves alone; for ADGCNN it ends at {paper.ACCURACY_AFTER}. Seconds are the least of the seeds.",
    )


def clouds_told(results: Results) -> str:
    """How many sizes and points a network's results are of."""
    return f"{len(results.config('dataset.sizes_mm2'))} sizes, {results.config('dataset.n_points')} points"


def fitted(results: Results, **cell: object) -> str:
    """Accuracy of a cylinder fit on a network's test clouds; empty in results from before it was recorded."""
    rows = results.rows(**cell)
    return results.mean("baseline_overall", **cell).format(3) if all("baseline_overall" in row for row in rows) else ""


CONDITIONS = {
    "noise_mm": "noise added, mm",
    "kept": "share of points kept",
    "hole_mm": "hole's radius, mm",
    "arc_deg": "arc seen, degrees",
    "version": "version of the clouds",
}


def robustness(results: Results) -> Table:
    """Accuracy on clouds made worse in one respect at a time."""
    rows = []
    for i, condition in enumerate(results.rows()[0]["conditions"]):
        accuracy, fit = (
            estimate([row["conditions"][i][who] for row in results.rows()]).format(3) for who in ("network", "fit")
        )
        rows.append([f"{CONDITIONS[condition['kind']]}: {_level(condition['level'])}", accuracy, fit])
    return Table(
        "Robustness: one respect at a time",
        ["Made worse", "ADGCNN", "cylinder fit"],
        rows,
        f"Accuracy, eq. (20). ADGCNN trained on `{results.config('dataset.version')}` clouds and tested on worse ones, beside "
        "the nearest nominal size to a cylinder fitted to the same clouds; "
        f"{results.config('dataset.n_points')} points a cloud, {told(results)}.",
    )


def versions(found: dict[str, Results]) -> Table:
    """ADGCNN trained and tested on standard and on hard clouds, each beside a fit."""
    rows = [
        [
            name,
            results.config("dataset.version"),
            results.mean(f"{who}_overall").format(3),
            results.mean(f"{who}_class_average").format(3),
            f"{results.config('dataset.n_points')}",
            f"{len(results.seeds)}",
        ]
        for results in found.values()
        for name, who in (("ADGCNN", "test"), ("Cylinder fit", "baseline"))
    ]
    guesses = {1 / len(results.config("dataset.sizes_mm2")) for results in found.values()}
    epochs = {str(results.config("training.epochs")) for results in found.values()}
    return Table(
        "ADGCNN on standard and on hard clouds",
        ["Method", "version", "accuracy [eq. (20)]", "class average [eq. (21)]", "points", "seeds"],
        rows,
        f"Trained and tested on clouds of the same version, {' or '.join(sorted(epochs))} epochs under Adadelta; a guess is "
        f"right {' or '.join(f'{guess:.3f}' for guess in sorted(guesses))} of the time. Hard: arcs of 60 to 120 degrees, noise "
        "of 0.3 to 0.6 mm, walls and other cables beside; there neither reads the size, and `measure_cable`, which looks for "
        "the cable among the rest, is not in this table.",
    )


def _level(level: float | str) -> str:
    return level if isinstance(level, str) else f"{level:g}"


def ablation(results: Results) -> Table:
    """ADGCNN with one part left out or one setting changed at a time."""
    full = results.mean("test_overall", variant="full").mean
    rows = [
        [
            f"ADGCNN, {VARIANTS[name]}",
            results.mean("test_overall", variant=name).format(3),
            results.mean("test_class_average", variant=name).format(3),
            "" if name == "full" else f"{results.mean('test_overall', variant=name).mean - full:+.3f}",
            f"{results.least('train_seconds', variant=name):.0f}",
        ]
        for name in VARIANTS
        if name in results.values("variant")
    ]
    return Table(
        "Ablation: what each part brings",
        ["Variant", "accuracy [eq. (20)]", "class average [eq. (21)]", "difference", "train (s)"],
        rows,
        f"Test accuracy at the epoch best on validation; {len(results.config('dataset.sizes_mm2'))} sizes, "
        f"{results.config('training.epochs')} epochs, {told(results)}. Seconds are the least of the seeds.",
    )
