"""Learning rates for a fair comparison: the same number of quasi-random trials for every optimizer, chosen on validation."""

from typing import Any

import numpy as np

from cablejax.io import read_json
from experiments import ROOT

SEARCH = "optimizer_search"
# The second number of each optimizer's search space, from and to; memories are drawn log-uniformly in their distance from 1.
SPACES: dict[str, tuple[str, float, float]] = {
    "sgd": ("momentum", 0.5, 0.99),
    "mbgd": ("momentum", 0.5, 0.99),
    "adadelta": ("rho", 0.8, 0.99),
    "adagrad": ("initial_accumulator_value", 0.001, 1.0),
    "rmsprop": ("decay", 0.8, 0.999),
    "adam": ("b1", 0.8, 0.99),
    "schedule_free": ("b1", 0.8, 0.99),
    "adamw": ("weight_decay", 0.0001, 0.1),
    "muon": ("beta", 0.8, 0.99),
}
MEMORIES = ("momentum", "rho", "decay", "b1", "beta")


def van_der_corput(index: int, base: int = 2) -> float:
    """The radical inverse: each new number falls into the widest gap left by those before.

    Example:
        >>> [van_der_corput(i) for i in range(1, 6)]
        [0.5, 0.25, 0.75, 0.125, 0.625]
    """
    number, share = 0.0, 1.0 / base
    while index:
        index, digit = divmod(index, base)
        number += share * digit
        share /= base
    return number


def trial_rate(lowest: float, highest: float, trial: int) -> float:
    """The learning rate of a trial (0, 1, ...), log-uniform between two bounds.

    Example:
        >>> [trial_rate(1e-4, 1.0, i) for i in range(3)]
        [0.01, 0.001, 0.1]
    """
    rate = lowest * (highest / lowest) ** van_der_corput(trial + 1)
    return float(f"{rate:.4g}")


def trial_options(optimizer: str, trial: int) -> dict[str, float]:
    """The second number of a trial: the other axis of a Halton sequence, of which `trial_rate` is the first.

    Example:
        >>> [trial_options("mbgd", i) for i in range(2)]
        [{'momentum': 0.8643}, {'momentum': 0.9632}]
    """
    name, lowest, highest = SPACES[optimizer]
    place = van_der_corput(trial + 1, base=3)
    if name in MEMORIES:
        value = 1.0 - (1.0 - lowest) * ((1.0 - highest) / (1.0 - lowest)) ** place
    else:
        value = lowest * (highest / lowest) ** place
    return {name: float(f"{value:.4g}")}


def best_accuracies(runs: list[dict[str, Any]]) -> dict[str, dict[float, float]]:
    """Of the runs of a search's results file, the best validation accuracy of every optimizer at every rate, mean over seeds."""
    found: dict[str, dict[float, list[float]]] = {}
    for row in runs:
        metrics = row["metrics"]
        rates = found.setdefault(row["cell"]["optimizer.name"], {})
        rates.setdefault(metrics["learning_rate"], []).append(metrics["validation_overall"])
    return {
        name: {rate: float(np.mean(values)) for rate, values in sorted(rates.items())} for name, rates in found.items()
    }


def tuned_rate(optimizer: str) -> float:
    """The learning rate with the best validation accuracy in results/optimizer_search.json; of equals the larger.

    Raises:
        ValueError: If the search was not made, or not for this optimizer.
    """
    path = ROOT / "results" / f"{SEARCH}.json"
    if not path.is_file():
        raise ValueError(f"rates=tuned: expected results/{SEARCH}.json; run `make {SEARCH}` first")
    accuracies = best_accuracies(read_json(path)["runs"])
    if optimizer not in accuracies:
        raise ValueError(f"rates=tuned: expected one of {', '.join(accuracies)}, got {optimizer}")
    rates = accuracies[optimizer]
    return max(rates, key=lambda rate: (rates[rate], rate))
