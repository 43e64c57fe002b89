"""Figures of the study: accuracy against epochs and trials, and performance profiles."""

from itertools import islice
from typing import Any

import numpy as np

from cablejax.report import line_styles
from experiments.analysis.results import NAMES, Results
from experiments.analysis.study_summary import OWN, arms, best_of_trials, final_rows, own_arm, profile
from experiments.display.drawing import Drawing, new_figure
from experiments.display.optimizers.study_tables import TITLES

LONG_NAME = 28  # letters
FACTORS = np.geomspace(1.0, 8.0, 40).tolist()


def curves(results: Results) -> Drawing | None:
    """Validation accuracy against epochs, and the best of n trials."""
    trials, there = best_of_trials(results), arms(results)
    if not trials:
        return None
    figure = new_figure(6.6, 3.8)
    left, right = figure.subplots(1, 2, sharey=True)
    names = list(dict.fromkeys([*trials, *there]))
    for style, arm in zip(_styles(len(names)), names, strict=True):
        if arm in there:
            runs = [row["history"]["validation_overall"] for row in final_rows(results, arm)]
            left.plot(*_middle(runs), **style)
        if arm in trials:
            right.plot(np.arange(1, len(trials[arm]) + 1), trials[arm], label=NAMES[arm], **style)
        else:
            right.plot([], [], label=NAMES[arm], **style)
    left.set_title("(a) final runs, median of seeds", loc="left", fontsize=10)
    left.set_xlabel("epoch")
    left.xaxis.get_major_locator().set_params(integer=True)
    left.set_ylabel("validation accuracy, eq. (20)")
    left.set_ylim(0, 1.02)
    right.set_title("(b) best of n trials, expected", loc="left", fontsize=10)
    right.set_xlabel("trials n")
    _legend(figure, right)
    title = TITLES[results.experiment]
    return Drawing(
        results.experiment,
        figure,
        f"Validation accuracy of every arm against epochs, and of the best of n tuning trials, {title}.",
        f"The study, {title}: what each reaches once tuned, and how many trials of tuning that takes.",
    )


def _styles(count: int) -> list[dict[str, Any]]:
    """Line styles; where they come round again, with dots on the line."""
    styles: list[dict[str, Any]] = []
    for style in islice(line_styles(), count):
        again = any(style.items() <= other.items() for other in styles)
        styles.append({**style, **({"marker": ".", "markevery": 3} if again else {})})
    return styles


def _middle(runs: list[list[float]]) -> tuple[np.ndarray, np.ndarray]:
    """Epochs and the median over runs, of which a diverged one has no history and counts as 0."""
    length = max(map(len, runs))
    padded = np.array([run + [run[-1] if run else 0.0] * (length - len(run)) for run in runs])
    return np.arange(1, length + 1), np.median(padded, axis=0)


def profiles(found: dict[str, Results]) -> Drawing | None:
    """Performance profiles over the parts that are complete."""
    complete = {name: each for name, each in found.items() if arms(each) and own_arm(each) == OWN}
    shares = profile(complete, FACTORS) if len(complete) > 1 else {}
    if not shares:
        return None
    figure = new_figure(6.6, 3.4)
    ax = figure.subplots()
    for style, (arm, share) in zip(_styles(len(shares)), shares.items(), strict=True):
        ax.step(FACTORS, share, where="post", label=NAMES[arm], **style)
    ax.set_xscale("log", base=2)
    ax.set_xlabel("updates to target, times the quickest arm's median")
    ax.set_ylabel("share of runs")
    ax.set_ylim(0, 1.02)
    _legend(figure, ax)
    return Drawing(
        "study_profiles",
        figure,
        "Share of runs that reach the target within a factor of the quickest optimizer, a curve for each.",
        f"Performance profiles over {len(complete)} parts of the study: the higher and the further left, the better.",
    )


def _legend(figure: Any, ax: Any) -> None:
    """Names below the panels, in as many columns as the longest leaves room for."""
    handles, names = ax.get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=3 if max(map(len, names)) < LONG_NAME else 2)
