"""Tables of the study: what each arm reaches, how it compares with Adadelta, and the verdict by rule."""

import math

from experiments.analysis import paper, rules
from experiments.analysis.inference import Comparison
from experiments.analysis.results import NAMES, Results
from experiments.analysis.study_summary import FAILURE, arms, comparisons, own_arm, speed, summary, verdict
from experiments.display.table import Table
from experiments.material.study_plan import PAPER_WAY

TITLES = {
    "study_standard_nofit": "standard clouds, no fit in the input",
    "study_standard_fit": "standard clouds, a fitted cylinder in the input",
    "study_hard_nofit": "hard clouds, no fit in the input",
    "study_modelnet10": "ModelNet10",
    "study_gradient_descent": "gradient descent by updates",
    "study_ablation": "parts of the network removed",
    "study_clouds": "number of training clouds",
    "study_point_networks": "networks on points, no fit in the input",
    "study_networks": "networks (Figures 5-8)",
}
CLAIM = f"Figure 13: choosing Adadelta raises the accuracy from {paper.ACCURACY_BEFORE} to {paper.ACCURACY_AFTER}"


def arms_table(results: Results) -> Table | None:
    """Every arm of a part: accuracy, failures, time to target."""
    found = {arm: summary(results, arm) for arm in arms(results)}
    if not found:
        return None
    rows = [
        [
            NAMES[arm],
            ", ".join(
                [
                    f"{each.learning_rate:g}",
                    *(
                        f"{name.removesuffix('_value').replace('_', ' ')} {value:g}"
                        for name, value in each.options.items()
                    ),
                ]
            ),
            each.accuracy.format(3),
            each.failed.format(2),
            _finite(each.updates),
            _finite(each.seconds),
            str(each.n),
        ]
        for arm, each in sorted(found.items(), key=lambda item: (item[1].updates, -item[1].accuracy.value))
    ]
    return Table(
        f"The study: {TITLES[results.experiment]}",
        [
            "Arm",
            "rate and second number",
            "accuracy [eq. (20)]",
            "share of failed runs",
            f"updates to {results.target:g}",
            "seconds to it",
            "seeds",
        ],
        rows,
        f"Accuracy: interquartile mean over seeds with its 95 % bootstrap interval. Failed: below {FAILURE:g}, Wilson's 95 % "
        f"interval. Updates and processor seconds until validation first reaches {results.target:g}: medians. "
        f"{results.config('training.epochs')} epochs of {results.updates_per_epoch} updates (gradient descent on the "
        f"whole set: 1), clouds new in every epoch where nothing else is said, size {results.size}; protocol in docs/study.md.",
    )


def _finite(value: float) -> str:
    return "not reached" if math.isinf(value) else f"{value:.0f}"


def against_table(results: Results) -> Table | None:
    """A part's own arm, tuned, against every other tuned one."""
    accuracy, faster = comparisons(results), speed(results)
    if not accuracy:
        return None
    rows = [
        [
            NAMES[arm],
            each.effect.format(3),
            f"{each.p:.3f}",
            rules.outcome(each, margin=rules.ACCURACY_MARGIN),
            faster[arm].effect.format(2),
            f"{faster[arm].p:.3f}",
            rules.outcome(faster[arm], margin=math.log2(rules.SPEED_FACTOR)),
        ]
        for arm, each in accuracy.items()
    ]
    return Table(
        f"{NAMES[own_arm(results)]} against each other arm: {TITLES[results.experiment]}",
        ["Against", "gain in accuracy", "p", "", "updates, log2 of theirs over its own", "p ", " "],
        rows,
        f"Paired over {next(iter(accuracy.values())).n} seeds: mean with its 95 % bootstrap interval; p of the sign-flip "
        "permutation test, Holm-adjusted, of optimizers over the paper's four others and over the rest. Holds: it is ahead; "
        f"refuted: behind; nil: the whole interval within {rules.ACCURACY_MARGIN:g} of accuracy, a factor of "
        f"{rules.SPEED_FACTOR:g} of updates; open: the interval is too wide to say.",
    )


CLAIMS = {
    "study_standard_nofit": CLAIM,
    "study_networks": "Figures 5-8: ADGCNN is more accurate than AlexNet, VGG-16 and ResNet50",
    "study_ablation": "Section III.A: channel attention, feature enhancement and feature fusion serve to extract the size better",
}


def claim(results: Results) -> tuple[str, str, str]:
    """The verdict on what a part's own arm is claimed to be: claim, what was found, and the word."""
    stated, (word, against) = CLAIMS[results.experiment], verdict(results)
    if word == rules.CANNOT_BE:
        return stated, "the study's final runs are not complete", word
    name = own_arm(results)
    own = summary(results, name)
    told = "; ".join(f"{NAMES[arm]} {told_of(each)}" for arm, each in against.items())
    setting = f"{TITLES[results.experiment]}, {own.n} seeds, size {results.size}"
    text = f"tuned alike ({setting}), {NAMES[name]} reaches {own.accuracy.format(3)}; its gain over {told}"
    if PAPER_WAY in arms(results):
        text += (
            f". The paper's way, rate 1 without warm-up and clipping: {summary(results, PAPER_WAY).accuracy.format(3)}"
        )
    return stated, text, word


def told_of(each: Comparison) -> str:
    """A comparison in a sentence."""
    return f"{each.effect.format(3)} (p {each.p:.3f}, {rules.outcome(each, margin=rules.ACCURACY_MARGIN)})"
