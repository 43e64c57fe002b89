"""The paper's claims, each held against the results: reproduced, not reproduced, or not to be tested, and why."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from experiments.analysis import paper, rules
from experiments.analysis.inference import Comparison, compare, compare_all
from experiments.analysis.results import NAMES, Results
from experiments.analysis.statistics import Estimate, estimate, fluctuation, paired_difference
from experiments.display.filtering.tables import FILTERS, NOISES
from experiments.display.networks.tables import NETWORKS
from experiments.display.optimizers import study_tables
from experiments.display.table import Table

YES, PARTLY, NO, CANNOT = rules.REPRODUCED, rules.IN_PART, rules.NOT_REPRODUCED, rules.CANNOT_BE
LEFT_TO_THE_EYE = 0.99  # recall of removal above which a picture shows no stray point
Found = dict[str, Results]


class Verdict(NamedTuple):
    """One row: what is claimed, what was found, and the word for it."""

    claim: str
    ours: str
    verdict: str


def remaining_points(found: Found) -> Verdict:
    results = found["table1_filtering"]
    left = {name: _over_noises(results, "remaining", name) for name in FILTERS}
    f1 = {name: _over_noises(results, "f1", name) for name in FILTERS}
    fewest = min(left, key=lambda name: left[name])
    return Verdict(
        "Table 1: the adaptive filter leaves the fewest points (30,454 of 53,135), so it cleans best",
        f"it leaves {left['adaptive']:,.0f}, {NAMES[fewest]} the fewest ({left[fewest]:,.0f}); F1 of removal against the truth "
        f"{f1['adaptive']:.3f}, best {max(f1.values()):.3f}. Its removal step is the statistical filter's, and a count says "
        "nothing of what was removed",
        YES if fewest == "adaptive" else NO,
    )


def filter_time(found: Found) -> Verdict:
    results = found["table1_filtering"]
    seconds = {name: _over_noises(results, "seconds", name) for name in FILTERS}
    ratio = seconds["adaptive"] / seconds["statistical"]
    return Verdict(
        "Table 1: the adaptive filter takes as long as the statistical one (0.308 s and 0.295 s, 1.04 times)",
        f"{seconds['adaptive']:.3f} s and {seconds['statistical']:.3f} s, {ratio:.2f} times",
        YES if ratio < 1.25 else NO,
    )


def slow_filters(found: Found) -> Verdict:
    results = found["table1_filtering"]
    seconds = {name: _over_noises(results, "seconds", name) for name in FILTERS}
    radius, median = (seconds[name] / seconds["statistical"] for name in ("radius", "median"))
    return Verdict(
        "Table 1: radius and median filtering take 7 and 10 times as long as statistical filtering",
        f"{radius:.1f} and {median:.1f} times",
        YES if min(radius, median) > 3 else NO,
    )


def residual_noise(found: Found) -> Verdict:
    results = found["table1_filtering"]
    recall = {noise: results.mean("recall", filter__name="adaptive", noise__kind=noise).mean for noise in NOISES}
    told = ", ".join(f"{NAMES[noise].lower()} noise {100 * (1 - value):.1f} %" for noise, value in recall.items())
    ahead = [noise for noise, value in recall.items() if value >= LEFT_TO_THE_EYE]
    return Verdict(
        "Section IV.A.2: after the adaptive filter the eye finds no noise point left, whatever the noise",
        f"of the outliers simulated it leaves: {told}",
        {len(NOISES): YES, 0: NO}.get(len(ahead), PARTLY),
    )


def best_removal(found: Found) -> Verdict:
    results = found["table1_outliers"]
    taken = 100 * (1 - paper.TABLE_1["statistical"]["gaussian"][0] / paper.SCAN_POINTS)
    share = min(results.values("scan.outlier_fraction"), key=lambda each: abs(100 * each - taken))
    f1 = {
        name: [row["f1"] for row in results.rows(filter__name=name, scan__outlier_fraction=share)] for name in FILTERS
    }
    means = {name: estimate(values).mean for name, values in f1.items()}
    told = ", ".join(f"{NAMES[name].lower()} {mean:.3f}" for name, mean in means.items() if name != "adaptive")
    return Verdict(
        "Section IV.A.2: taken together, the adaptive filter removes noise better than the other three",
        f"of a scan with {100 * share:g} % of outliers, about what the paper's filters take away, F1 {means['adaptive']:.3f}; "
        f"{told}. It removes what the statistical filter removes, whose threshold rises with many outliers",
        rules.verdict(_against(f1, "adaptive").values()),
    )


def spread(found: Found) -> Verdict:
    results = found["table2_3_deviation"]
    fall = {order: _fall_percent(results, order) for order in results.values("filter.order")}
    others = ", ".join(f"order {order}: {value:.0f} %" for order, value in fall.items() if order)
    return Verdict(
        f"Tables 2-3: the standard deviation falls by {paper.STD_REDUCTION_PERCENT:g} %",
        f"by {fall[0]:.0f} % with the paper's filter ({others}), on a scan whose floor is simulated",
        YES if fall[0] >= paper.STD_REDUCTION_PERCENT else NO,
    )


def mean_deviation(found: Found) -> Verdict:
    results = found["table2_3_deviation"]
    before, after = (results.mean(f"{when}.mean_mm", filter__order=0).mean for when in ("before", "after"))
    best = results.mean("after.mean_mm", filter__order=2).mean
    return Verdict(
        "Tables 2-3: the mean deviation goes from -0.2959 mm to 0.0008 mm",
        f"from {before:.4f} to {after:.4f} mm with the paper's filter, to {best:.4f} mm with order 2. A weighted mean of "
        "neighbours cannot move a surface outwards by 0.3 mm: on a convex one it moves it inwards",
        NO,
    )


def tolerance(found: Found) -> Verdict:
    results = found["table2_3_deviation"]
    before, after = (results.mean(f"{when}.within_percent", filter__order=0).mean for when in ("before", "after"))
    return Verdict(
        "Tables 2-3: the share within the tolerance rises from 16.78 % to 29.45 %, by three quarters",
        f"from {before:.1f} % to {after:.1f} %, by {100 * (after / before - 1):.0f} %, within ±"
        f"{results.config('tolerance_mm'):g} mm (the paper gives no tolerance)",
        YES if after >= 1.75 * before else NO,
    )


def best_network(found: Found) -> Verdict:
    accuracy = {name: found[name].mean("test_overall") for name in NETWORKS}
    word = rules.verdict(_against({name: _tested(found[name]) for name in NETWORKS}, "fig8_adgcnn").values())
    own = accuracy.pop("fig8_adgcnn")
    rival = max(accuracy, key=lambda name: accuracy[name].mean)
    name = NAMES[found[rival].config("model.name")]
    epochs = {each: found[each].config("training.epochs") for each in ("fig8_adgcnn", rival)}
    sizes = {len(found[each].config("dataset.sizes_mm2")) for each in NETWORKS}
    alike = "" if len(sizes) == 1 else ". The networks' results are of different numbers of sizes, so this says nothing"
    return Verdict(
        "Figures 5-8: ADGCNN is more accurate than AlexNet, VGG-16 and ResNet50",
        f"ADGCNN {own.format(3)} after {epochs['fig8_adgcnn']} epochs, {name}, the best of the others, "
        f"{accuracy[rival].format(3)} after {epochs[rival]}" + alike,
        CANNOT if alike else word,
    )


def smoothest_network(found: Found) -> Verdict:
    told, compared = [], []
    for kind in ("training", "validation"):
        key = "train_loss" if kind == "training" else "validation_loss"
        each = {
            name: [fluctuation([e[key] for e in row["history"]]) for row in found[name].rows()] for name in NETWORKS
        }
        compared += _against(
            {name: [-value for value in values] for name, values in each.items()}, "fig8_adgcnn"
        ).values()
        rough = {name: estimate(values).mean for name, values in each.items()}
        each = ", ".join(f"{NAMES[found[name].config('model.name')]} {value:.4f}" for name, value in rough.items())
        told.append(f"{kind}: {each} nats")
    return Verdict(
        "Figures 9-12: ADGCNN's loss fluctuates least",
        "; ".join(told),
        rules.verdict(compared, margin=0.0),
    )


def best_optimizer(found: Found) -> Verdict:
    results = found["optimizer_study"]
    own = [row["test_overall"] for row in results.rows(optimizer__name="adadelta", rates="tuned")]
    rivals = {
        name: [row["test_overall"] for row in results.rows(optimizer__name=name, rates="tuned")]
        for name in ("sgd", "mbgd", "adagrad", "rmsprop")
    }
    gains = {name: paired_difference(own, other)[0] for name, other in rivals.items()}
    compared = compare_all(own, rivals)
    ahead = [
        name for name, each in compared.items() if rules.outcome(each, margin=rules.ACCURACY_MARGIN) == rules.HOLDS
    ]
    least = min(gains, key=lambda name: gains[name].mean)
    keras = results.mean("test_overall", optimizer__name="adadelta", rates="keras")
    return Verdict(
        f"Figure 13: choosing Adadelta raises the accuracy from {paper.ACCURACY_BEFORE} to {paper.ACCURACY_AFTER}",
        f"tuned alike, Adadelta reaches {estimate(own).format(3)}, surely ahead of {len(ahead)} of 4 others "
        f"(permutation test over {len(own)} seeds, Holm); against {NAMES[least]} the gain is {gains[least].format(3)}. "
        f"At Keras' rate of 0.001 Adadelta reaches {keras.format(3)}",
        rules.verdict(compared.values()),
    )


def by_the_study(found: Found) -> Verdict:
    """By the study's rules, see docs/study.md."""
    (results,) = found.values()
    return Verdict(*study_tables.claim(results))


def loss_falls(found: Found) -> Verdict:
    results = found["fig13_optimizers"]
    last = {
        name: estimate([row["history"][-1]["train_loss"] for row in results.rows(optimizer__name=name)])
        for name in results.values("optimizer.name")
    }
    least = min(last, key=lambda name: last[name].mean)
    first = estimate([row["history"][0]["train_loss"] for row in results.rows(optimizer__name="adadelta")])
    return Verdict(
        "Figure 13: under Adadelta the training loss gradually goes towards 0",
        f"from {first.format(2)} in the first epoch to {last['adadelta'].format(2)} nats in the last; the least is "
        f"{NAMES[least]}'s, {last[least].format(2)}",
        YES if last["adadelta"].mean < 0.1 * first.mean else PARTLY if last["adadelta"].mean < first.mean else NO,
    )


def transfer_learning(found: Found) -> Verdict:
    results = found["fig13_transfer"]
    start = {
        name: [row["test_overall"] for row in results.rows(optimizer__name="adadelta", transfer=name)]
        for name in ("none", "modelnet10")
    }
    gain, _ = paired_difference(start["modelnet10"], start["none"])
    return Verdict(
        "Figure 13: the network is built by transfer learning",
        f"from ModelNet10's weights Adadelta reaches {estimate(start['modelnet10']).format(3)}, from random ones "
        f"{estimate(start['none']).format(3)}, gain {gain.format(3)}. The paper names no source and gives no number without it",
        CANNOT,
    )


def filter_helps(found: Found) -> Verdict:
    gain = _gain(found["ablation"], "filtered", "full")
    return Verdict(
        "Section IV.A: filtering secures what is learnt from the points afterwards",
        f"ADGCNN on filtered instead of raw clouds gains {gain.format(3)} in test accuracy",
        rules.verdict([compare(*_pair(found["ablation"], "filtered", "full"))]),
    )


def parts_help(found: Found) -> Verdict:
    parts = {"no_attention": "attention", "no_enhancement": "enhancement", "no_fusion": "fusion"}
    gains = {name: _gain(found["ablation"], "full", variant) for variant, name in parts.items()}
    removed = {variant: _pair(found["ablation"], "full", variant)[1] for variant in parts}
    compared = compare_all(_pair(found["ablation"], "full", "full")[0], removed)
    return Verdict(
        "Section III.A: channel attention, feature enhancement and feature fusion serve to extract the size better",
        "gain in test accuracy over the network without: "
        + ", ".join(f"{name} {gain.format(3)}" for name, gain in gains.items()),
        rules.verdict(compared.values()),
    )


def final_accuracy(found: Found) -> Verdict:
    results = found["standard_adgcnn"]
    fit = [row["baseline_overall"] for row in results.rows() if "baseline_overall" in row]
    beside = f", a cylinder fit with no network {estimate(fit).format(3)}" if fit else ""
    return Verdict(
        f"Section V: ADGCNN under Adadelta classifies {paper.ACCURACY_AFTER} of the cables rightly",
        f"{results.mean('test_overall').format(3)} on {len(results.config('dataset.sizes_mm2'))} simulated sizes{beside}. The "
        "paper's clouds and its classes are not published",
        CANNOT,
    )


def _gain(results: Results, better: str, worse: str) -> Estimate:
    """Difference in test accuracy between two variants, paired by seed."""
    return paired_difference(*_pair(results, better, worse))[0]


def _pair(results: Results, first: str, second: str) -> tuple[list[float], list[float]]:
    """Test accuracies of two variants, by seed."""
    return _tested(results, variant=first), _tested(results, variant=second)


def _tested(results: Results, **cell: Any) -> list[float]:
    return [row["test_overall"] for row in results.rows(**cell)]


def _against(values: dict[str, list[float]], own: str) -> dict[str, Comparison]:
    """One against each of the others over the seeds that all have, the first ones."""
    seeds = min(map(len, values.values()))
    return compare_all(values[own][:seeds], {name: each[:seeds] for name, each in values.items() if name != own})


CLAIMS: tuple[tuple[tuple[str, ...], Callable[[Found], Verdict]], ...] = (
    (("table1_filtering",), remaining_points),
    (("table1_filtering",), filter_time),
    (("table1_filtering",), slow_filters),
    (("table1_filtering",), residual_noise),
    (("table1_outliers",), best_removal),
    (("table2_3_deviation",), spread),
    (("table2_3_deviation",), mean_deviation),
    (("table2_3_deviation",), tolerance),
    (("ablation",), filter_helps),
    (("ablation",), parts_help),
    (NETWORKS, best_network),
    (NETWORKS, smoothest_network),
    (("fig13_optimizers",), loss_falls),
    (("optimizer_study",), best_optimizer),
    *(((name,), by_the_study) for name in study_tables.CLAIMS),
    (("fig13_transfer",), transfer_learning),
    (("standard_adgcnn",), final_accuracy),
)


SUPERSEDED: dict[Callable[[Found], Verdict], str] = {
    best_optimizer: "study_standard_nofit",
    best_network: "study_networks",
    parts_help: "study_ablation",
}


def _decided(folder: Path) -> set[str]:
    """Parts of the study whose final runs are complete enough for their verdict."""
    found = {name: Results.read(folder, name) for name in study_tables.CLAIMS}
    return {name for name, each in found.items() if each is not None and study_tables.claim(each)[2] != CANNOT}


def verdict_table(folder: Path) -> Table | None:
    """Every claim whose results are all in the folder, with its verdict; None where there is none."""
    rows, decided = [], _decided(folder)
    for names, judge in CLAIMS:
        # The study's verdict takes the place of that of the older runs, of fixed clouds and three seeds at most.
        if SUPERSEDED.get(judge) in decided or (judge is by_the_study and names[0] not in decided):
            continue
        found = {name: results for name in names if (results := Results.read(folder, name)) is not None}
        if len(found) == len(names):
            rows.append(list(judge(found)))
    if not rows:
        return None
    return Table(
        "The paper's claims",
        ["Claim", "Here", "Verdict"],
        rows,
        "The paper's scan and training data are not published: what is reproduced is the claim's kind, not its numbers.",
    )


def _over_noises(results: Results, metric: str, name: str) -> float:
    """A metric of a filter, averaged over the kinds of noise, as in the paper's column of means."""
    return sum(results.mean(metric, filter__name=name, noise__kind=noise).mean for noise in NOISES) / len(NOISES)


def _fall_percent(results: Results, order: int) -> float:
    """By how much the standard deviation falls, averaged over the noise levels."""
    before, after = (results.mean(f"{when}.std_mm", filter__order=order).mean for when in ("before", "after"))
    return 100 * (1 - after / before)
