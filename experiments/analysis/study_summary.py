"""What the study's results say, by docs/study.md: one summary an arm, comparisons with Adadelta, and the verdict."""

import math
from typing import Any, NamedTuple

import numpy as np

from experiments.analysis import rules
from experiments.analysis.inference import (
    Comparison,
    Interval,
    best_of,
    bootstrap,
    compare_all,
    epochs_to_target,
    performance_profile,
    wilson,
)  # fmt: skip
from experiments.analysis.results import Results
from experiments.material.study_plan import FINAL, PAPER_WAY, SEARCH

FAILURE = 0.5  # test accuracy below which a run has failed
OWN = "adadelta"  # of the parts on optimizers
PAPERS = ("sgd", "mbgd", "adagrad", "rmsprop")  # the paper's other optimizers
# Whom the claim of a part is about.
RIVALS = {
    **dict.fromkeys(("study_standard_nofit", "study_standard_fit", "study_hard_nofit", "study_modelnet10"), PAPERS),
    "study_networks": ("alexnet", "vgg16", "resnet50"),
    "study_ablation": ("no_attention", "no_enhancement", "no_fusion"),
}
FULL_SET = "sgd"


class Arm(NamedTuple):
    """The final runs of one arm.

    Attributes:
        accuracy: Interquartile mean of the test accuracy, with its bootstrap interval.
        failed: Share of runs that failed, with Wilson's interval.
        updates: Median updates to the target; infinite where half of the runs never reach it.
        seconds: Median processor seconds to it.
        learning_rate: The chosen one.
        options: The chosen second number.
        n: Seeds.
    """

    accuracy: Interval
    failed: Interval
    updates: float
    seconds: float
    learning_rate: float
    options: dict[str, float]
    n: int


def final_rows(results: Results, arm: str) -> list[dict[str, Any]]:
    """An arm's final runs, by seed."""
    rows = [row for row in results.runs if row["stage"] == FINAL and row["arm"] == arm]
    return sorted(rows, key=lambda row: row["seed"])


def arms(results: Results) -> list[str]:
    """The arms whose final stage is complete, in the study's order."""
    return list(dict.fromkeys(row["arm"] for row in results.runs if row["stage"] == FINAL))


def own_arm(results: Results) -> str:
    """The arm that the others are compared with."""
    return results.own


def updates_to_target(results: Results, arm: str) -> list[float]:
    """Updates until validation first reached the target, by seed; infinite where it never did."""
    each = 1 if arm == FULL_SET else results.updates_per_epoch
    return [each * _epochs(results, row) for row in final_rows(results, arm)]


def _epochs(results: Results, row: dict[str, Any]) -> float:
    return epochs_to_target(row["history"]["validation_overall"], results.target)


def _seconds(results: Results, row: dict[str, Any]) -> float:
    """Of the processor, at the run's mean an epoch, validation included: the clock tells what else the machine did."""
    return _epochs(results, row) * row["cpu_seconds"] / max(1, len(row["history"]["seconds"]))


def summary(results: Results, arm: str) -> Arm:
    """What the final runs of an arm say."""
    rows = final_rows(results, arm)
    accuracy = [row["test_overall"] for row in rows]
    return Arm(
        accuracy=bootstrap(accuracy),
        failed=wilson(sum(value < FAILURE for value in accuracy), len(accuracy)),
        updates=float(np.median(updates_to_target(results, arm))),
        seconds=float(np.median([_seconds(results, row) for row in rows])),
        learning_rate=rows[0]["learning_rate"],
        options=rows[0]["options"],
        n=len(rows),
    )


def comparisons(results: Results) -> dict[str, Comparison]:
    """Test accuracy of a part's own arm minus that of each other tuned arm, paired by seed; empty without its own.

    Of optimizers Holm-adjusted in two families: the paper's four others, which its claim is about, and those that came after.
    """
    found = {arm: [row["test_overall"] for row in final_rows(results, arm)] for arm in arms(results)}
    own = found.pop(own_arm(results), None)
    found.pop(PAPER_WAY, None)
    return {} if own is None else _by_family(own, found)


def _by_family(own: list[float], others: dict[str, list[float]]) -> dict[str, Comparison]:
    families = ({arm: each for arm, each in others.items() if (arm in PAPERS) == theirs} for theirs in (True, False))
    return {arm: each for family in families if family for arm, each in compare_all(own, family).items()}


def speed(results: Results) -> dict[str, Comparison]:
    """log2 of the updates that each other arm takes over a part's own; a run that never got there took twice the budget."""
    found = {arm: _log_updates(results, arm) for arm in arms(results) if arm != PAPER_WAY}
    own = found.pop(own_arm(results), None)
    if own is None:
        return {}
    return _by_family([-value for value in own], {arm: [-value for value in each] for arm, each in found.items()})


def _log_updates(results: Results, arm: str) -> list[float]:
    budget = results.updates_per_epoch * results.config("training.epochs")
    return [math.log2(min(value, 2 * budget)) for value in updates_to_target(results, arm)]


def verdict(results: Results) -> tuple[str, dict[str, Comparison]]:
    """Whether a part's own arm is ahead of those that the paper's claim is about, and the comparisons that say so."""
    rivals = RIVALS[results.experiment]
    against = {arm: each for arm, each in comparisons(results).items() if arm in rivals}
    if len(against) < len(rivals):
        return rules.CANNOT_BE, against
    return rules.verdict(against.values()), against


def best_of_trials(results: Results) -> dict[str, list[float]]:
    """Expected best validation accuracy of n search trials, n = 1, 2, ..., by arm."""
    found: dict[str, list[float]] = {}
    for row in results.runs:
        if row["stage"] == SEARCH:
            found.setdefault(row["arm"], []).append(row["validation_overall"])
    return {arm: best_of(values).tolist() for arm, values in found.items()}


def profile(found: dict[str, Results], factors: list[float]) -> dict[str, list[float]]:
    """Performance profiles over the parts, of the arms that all of them have."""
    shared = set.intersection(*(set(arms(results)) for results in found.values()))
    costs = {arm: {part: updates_to_target(results, arm) for part, results in found.items()} for arm in sorted(shared)}
    return performance_profile(costs, factors) if costs else {}
