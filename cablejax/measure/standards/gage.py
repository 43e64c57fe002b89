"""Repeatability and reproducibility of a measurement (AIAG, Measurement Systems Analysis, 4th edition, chapter III.B)."""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import fdtrc

POOLING = 0.25  # probability above which the interaction is taken for repeatability
CATEGORIES = 1.41  # of AIAG: the square root of 2, as it prints it
SPREAD = 6.0  # standard deviations in a process's or a tolerance's width


class GageStudy(NamedTuple):
    """Standard deviations of the components of variation, in the unit of the values.

    Attributes:
        repeatability: Of the equipment (EV): trials of one operator on one part.
        reproducibility: Of the operators (AV), their interaction with the parts included; 0 for one operator.
        interaction: Of operators with parts; 0 where it was pooled with repeatability.
        gage: Repeatability and reproducibility together (GRR).
        part: Of the parts (PV); 0 for one part.
        total: Of all (TV).
        percent_gage: GRR over TV, in percent.
        percent_tolerance: Six times GRR over the tolerance, in percent; None without one.
        categories: Number of distinct categories (ndc), 1.41 PV over GRR, cut to a whole number.
        interaction_p: Probability of an interaction as large by chance; None where it cannot be told.
        verdict: AIAG's: "acceptable" up to 10 % GRR with 5 categories or more, "may be acceptable" up to 30 %, else
            "unacceptable".
    """

    repeatability: float
    reproducibility: float
    interaction: float
    gage: float
    part: float
    total: float
    percent_gage: float
    percent_tolerance: float | None
    categories: int
    interaction_p: float | None
    verdict: str


def gage_study(values: Float[np.ndarray, "parts operators trials"], *, tolerance: float | None = None) -> GageStudy:
    """Split the variation of repeated measurements by analysis of variance, with operators and parts random.

    Components of variance that come out negative are zero. The interaction is pooled with repeatability where it is not
    significant (p > 0.25).

    Args:
        values: A measurement for each part, operator and trial `[parts, operators, trials]`.
        tolerance: Width of the tolerance, in the values' unit.

    Raises:
        ValueError: If there are fewer than two trials, a value is not finite, all are the same, or the tolerance is not
            positive.

    Example:
        >>> rng = np.random.default_rng(0)
        >>> parts, operators = rng.normal(0, 1.0, (10, 1, 1)), rng.normal(0, 0.05, (1, 3, 1))
        >>> study = gage_study(30 + parts + operators + rng.normal(0, 0.02, (10, 3, 3)))
        >>> study.categories > 5, study.verdict
        (True, 'acceptable')
    """
    values = np.asarray(values, dtype=float)
    if values.ndim != 3 or values.shape[2] < 2:
        raise ValueError(
            f"values: expected [parts, operators, trials] with two trials or more, got {list(values.shape)}"
        )
    if not np.isfinite(values).all():
        raise ValueError(f"values: expected finite numbers, got {(~np.isfinite(values)).sum()} that are not")
    if tolerance is not None and not tolerance > 0:
        raise ValueError(f"tolerance: expected a positive number, got {tolerance}")
    repeat, together, operator, part, p = _components(values)
    between = operator + together
    gage = repeat + between
    total = gage + part
    if total == 0:
        raise ValueError("values: expected numbers that differ, got one alone")
    share = 100 * math.sqrt(gage / total)
    categories = int(CATEGORIES * math.sqrt(part / gage)) if gage > 0 else 0
    return GageStudy(
        repeatability=math.sqrt(repeat),
        reproducibility=math.sqrt(between),
        interaction=math.sqrt(together),
        gage=math.sqrt(gage),
        part=math.sqrt(part),
        total=math.sqrt(total),
        percent_gage=share,
        percent_tolerance=None if tolerance is None else 100 * SPREAD * math.sqrt(gage) / tolerance,
        categories=categories,
        interaction_p=p,
        verdict=_verdict(share, categories),
    )


class Anova(NamedTuple):
    """Sums of squares and degrees of freedom of the two-way table, in the order part, operator, interaction, error."""

    squares: tuple[float, float, float, float]
    freedom: tuple[int, int, int, int]


def anova(values: Float[np.ndarray, "parts operators trials"]) -> Anova:
    """The balanced two-way analysis of variance with an interaction."""
    p, o, t = values.shape
    mean, cell = values.mean(), values.mean(axis=2)
    by_part, by_operator = values.mean(axis=(1, 2)), values.mean(axis=(0, 2))
    both = cell - by_part[:, None] - by_operator[None] + mean
    squares = (
        o * t * float(((by_part - mean) ** 2).sum()),
        p * t * float(((by_operator - mean) ** 2).sum()),
        t * float((both**2).sum()),
        float(((values - cell[:, :, None]) ** 2).sum()),
    )
    return Anova(squares, (p - 1, o - 1, (p - 1) * (o - 1), p * o * (t - 1)))


def _components(values: np.ndarray) -> tuple[float, float, float, float, float | None]:
    """Variances of repeatability, interaction, operators and parts; the interaction's probability."""
    p, o, t = values.shape
    squares, freedom = anova(values)
    mean = [square / free if free else 0.0 for square, free in zip(squares, freedom, strict=True)]
    chance = None
    if freedom[2] and mean[3] > 0:
        chance = float(fdtrc(freedom[2], freedom[3], mean[2] / mean[3]))
    if not freedom[2] or (chance is not None and chance > POOLING):
        repeat = (squares[2] + squares[3]) / (freedom[2] + freedom[3])
        return repeat, 0.0, *_main(mean, repeat, (p, o, t)), chance
    return mean[3], max(0.0, (mean[2] - mean[3]) / t), *_main(mean, mean[2], (p, o, t)), chance


def _main(mean: list[float], against: float, shape: tuple[int, int, int]) -> tuple[float, float]:
    """Variances of operators and parts, above the mean square that chance alone would give them."""
    p, o, t = shape
    operator = max(0.0, (mean[1] - against) / (p * t)) if o > 1 else 0.0
    return operator, max(0.0, (mean[0] - against) / (o * t)) if p > 1 else 0.0


def _verdict(percent: float, categories: int) -> str:
    if percent <= 10 and categories >= 5:
        return "acceptable"
    return "may be acceptable" if percent <= 30 else "unacceptable"
