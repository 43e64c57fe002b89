"""The typed schema of every configuration key; YAML under conf/ may set these and nothing else.

Each dataclass checks its own values when it is built, so that a wrong value stops a run at once, in one line.
"""

from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from hydra.core.config_store import ConfigStore
from omegaconf import MISSING, OmegaConf

from experiments.harness import tuning

NOISE_KINDS = ("none", "gaussian", "random", "compound")
FORMS = ("linear", "exponential")
PRESETS = ("paper-floor", "paper-aligned", "structured-light", "line-laser", "terrestrial")
VERSIONS = ("clean", "standard", "hard", "real-like")
MIXES = ("cables", "wide")
SIZES = ("smoke", "quick", "paper")
SCHEDULES = ("constant", "cosine")


def _check(ok: bool, key: str, expected: str, got: object) -> None:
    if not ok:
        raise ValueError(f"{key}: expected {expected}, got {got!r}")


@dataclass
class FilterConfig:
    """What every filter has in common."""

    name: str = MISSING
    k: int = 20

    def __post_init__(self) -> None:
        _check(1 <= self.k <= 128, "filter.k", "between 1 and 128 neighbours", self.k)


@dataclass
class StatisticalFilterConfig(FilterConfig):
    name: str = "statistical"
    std_ratio: float = 2.0

    def __post_init__(self) -> None:
        super().__post_init__()
        _check(self.std_ratio > 0, "filter.std_ratio", "a positive number of standard deviations", self.std_ratio)


@dataclass
class RadiusFilterConfig(FilterConfig):
    name: str = "radius"
    radius_mm: float = 2.0
    min_neighbors: int = 4

    def __post_init__(self) -> None:
        super().__post_init__()
        _check(self.radius_mm > 0, "filter.radius_mm", "a positive radius in mm", self.radius_mm)
        _check(self.min_neighbors >= 1, "filter.min_neighbors", "at least 1", self.min_neighbors)


@dataclass
class MedianFilterConfig(FilterConfig):
    name: str = "median"
    ratio: float = 3.0

    def __post_init__(self) -> None:
        super().__post_init__()
        _check(self.ratio > 0, "filter.ratio", "a positive ratio to the median", self.ratio)


@dataclass
class AdaptiveFilterConfig(FilterConfig):
    """Eqs. (2)-(8) behind statistical outlier removal; None estimates a value from the scan.

    `smooth_k` None is 40 for the paper's mean and 100 for planes and quadrics, which need more points. `gamma` None is 0.1
    for the mean and 0 for surfaces: eq. (7) gives more say to points that stick out, which noise makes too.
    """

    name: str = "adaptive"
    std_ratio: float = 2.0
    smooth_k: int | None = None
    order: int = 0
    form: str = "linear"
    iterations: int = 1
    alpha: float | None = None
    beta_mm: float | None = None
    gamma: float | None = None
    tau: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        _check(self.std_ratio > 0, "filter.std_ratio", "a positive number of standard deviations", self.std_ratio)
        if self.smooth_k is not None:
            _check(1 <= self.smooth_k <= 128, "filter.smooth_k", "between 1 and 128 neighbours", self.smooth_k)
        _check(self.order in (0, 1, 2), "filter.order", "0 (the paper), 1 (plane) or 2 (quadric)", self.order)
        _check(self.form in FORMS, "filter.form", f"one of {', '.join(FORMS)}", self.form)
        _check(self.iterations >= 1, "filter.iterations", "at least 1", self.iterations)


@dataclass
class NoiseConfig:
    """Noise added on top of the scanner's own."""

    kind: str = MISSING
    snr_db: float = 60.0

    def __post_init__(self) -> None:
        _check(self.kind in NOISE_KINDS, "noise.kind", f"one of {', '.join(NOISE_KINDS)}", self.kind)


@dataclass
class ScanConfig:
    """The simulated scan, or a file to take its place."""

    preset: str = MISSING
    n_points: int = 53_135
    size_mm2: float = 240.0
    shape: str = "straight"
    arc_deg: float = 360.0
    outlier_fraction: float = 0.02

    def __post_init__(self) -> None:
        _check(self.preset in PRESETS, "scan.preset", f"one of {', '.join(PRESETS)}", self.preset)
        _check(self.n_points >= 100, "scan.n_points", "at least 100 points", self.n_points)
        _check(0 < self.arc_deg <= 360, "scan.arc_deg", "above 0 and at most 360 degrees", self.arc_deg)
        _check(0 <= self.outlier_fraction < 0.5, "scan.outlier_fraction", "in [0, 0.5)", self.outlier_fraction)


@dataclass
class DatasetConfig:
    """Simulated training clouds, one class per nominal cross-section."""

    version: str = MISSING
    filtered: bool = False  # clouds go through outlier removal and the adaptive filter (order 2) first
    sizes_mm2: list[float] = field(default_factory=lambda: [25, 35, 50, 70, 95, 120, 150, 185, 240, 300, 400, 500, 630])
    n_points: int = 256
    train_per_class: int = 32
    validation_per_class: int = 24
    test_per_class: int = 48
    canonical_pose: bool = True
    fresh: bool = False  # new training clouds in every epoch
    pool: int | None = None  # with fresh: so many epochs' clouds, over and over; None never repeats one
    seed: int = 0

    def __post_init__(self) -> None:
        _check(self.version in VERSIONS, "dataset.version", f"one of {', '.join(VERSIONS)}", self.version)
        _check(len(self.sizes_mm2) >= 2, "dataset.sizes_mm2", "at least 2 sizes", list(self.sizes_mm2))
        _check(64 <= self.n_points <= 4096, "dataset.n_points", "between 64 and 4096", self.n_points)
        _check(self.pool is None or (self.fresh and self.pool >= 1), "dataset.pool",
               "at least 1 epoch's clouds, with dataset.fresh=true", self.pool)  # fmt: skip
        for name in ("train_per_class", "validation_per_class", "test_per_class"):
            _check(getattr(self, name) >= 1, f"dataset.{name}", "at least 1 cloud", getattr(self, name))


@dataclass
class PartsConfig:
    """Clouds whose points are labelled by part, for experiments.parts."""

    n_points: int = 1024
    ball_mm: float = 250.0
    mix: str = "cables"
    train: int = 2048
    validation: int = 128
    test: int = 384

    def __post_init__(self) -> None:
        _check(64 <= self.n_points <= 4096, "parts.n_points", "between 64 and 4096", self.n_points)
        _check(self.ball_mm > 0, "parts.ball_mm", "a positive radius in mm", self.ball_mm)
        _check(self.mix in MIXES, "parts.mix", f"one of {', '.join(MIXES)}", self.mix)
        for name in ("train", "validation", "test"):
            _check(getattr(self, name) >= 1, f"parts.{name}", "at least 1 cloud", getattr(self, name))


@dataclass
class ModelConfig:
    """Which network, and what it is built with; `options` go to `cablejax.nets.build_model`."""

    name: str = MISSING
    options: dict[str, Any] = field(default_factory=dict)


@dataclass
class OptimizerConfig:
    """Which optimizer; the learning rate is always explicit.

    Attributes:
        lowest_rate: The least learning rate that tuning tries; four decades for every optimizer.
        highest_rate: The largest.
        keras_rate: Keras' (and TensorFlow's) default, which the paper's framework would have used.
    """

    name: str = MISSING
    learning_rate: float = MISSING
    lowest_rate: float = MISSING
    highest_rate: float = MISSING
    keras_rate: float = MISSING
    options: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        _check(self.learning_rate > 0, "optimizer.learning_rate", "a positive learning rate", self.learning_rate)
        _check(0 < self.lowest_rate < self.highest_rate, "optimizer.lowest_rate", "above 0 and below highest_rate",
               self.lowest_rate)  # fmt: skip


@dataclass
class TrainingConfig:
    """Budget and regularisation of a training run."""

    epochs: int = 10
    batch_size: int = 24  # can be cut over 2, 3, 4, 6 or 8 devices
    eval_batch_size: int = 32
    steps_per_dispatch: int = 10  # at most so many steps a compiled call
    schedule: str = "cosine"
    warmup_epochs: float = 0.0  # the rate rises linearly over these
    clip_norm: float | None = None  # largest global norm of a gradient
    patience: int | None = None  # epochs without a better validation accuracy, after which a run stops
    give_up_epoch: int | None = None  # a run stops there if its training loss was never below give_up_loss
    give_up_loss: float = 0.0
    keep_best: bool = True  # False tests the last epoch's weights instead of those best on validation
    balanced: bool = True  # every batch holds about the same mix of classes
    ema_decay: float | None = None  # per update, of averaged weights; None evaluates the weights themselves
    label_smoothing: float = 0.0
    test: bool = True  # False while tuning: the test split is touched once, by what was chosen on validation
    keep_diverged: bool = False  # True records a loss that is no number as accuracy 0 instead of stopping
    # Folder of another training run whose weights this one starts from, and parts of the network that stay as they are.
    init_from: str | None = None
    frozen: list[str] = field(default_factory=list)
    precision: str = "float32"

    def __post_init__(self) -> None:
        _check(self.batch_size >= 2, "training.batch_size", "at least 2 clouds (batch norm)", self.batch_size)
        _check(self.schedule in SCHEDULES, "training.schedule", f"one of {', '.join(SCHEDULES)}", self.schedule)
        for name in ("epochs", "eval_batch_size", "steps_per_dispatch"):
            _check(getattr(self, name) >= 1, f"training.{name}", "at least 1", getattr(self, name))
        _check(self.warmup_epochs >= 0, "training.warmup_epochs", "0 epochs or more", self.warmup_epochs)
        _check(self.clip_norm is None or self.clip_norm > 0, "training.clip_norm", "a positive norm", self.clip_norm)
        _check(self.patience is None or self.patience >= 1, "training.patience", "at least 1 epoch", self.patience)
        _check(self.give_up_epoch is None or self.give_up_epoch >= 1, "training.give_up_epoch", "at least 1 epoch",
               self.give_up_epoch)  # fmt: skip
        _check(self.ema_decay is None or 0 < self.ema_decay < 1, "training.ema_decay", "in (0, 1)", self.ema_decay)
        _check(0 <= self.label_smoothing < 1, "training.label_smoothing", "in [0, 1)", self.label_smoothing)


@dataclass
class Config:
    """One run of one experiment."""

    name: str = MISSING
    size: str = "quick"
    seed: int = 0
    rates: str = "stated"
    trial: int = 0
    variant: str = "full"
    transfer: str = "none"
    out: str = "runs"
    tolerance_mm: float = 0.1
    timing_repeats: int = 3
    filter: FilterConfig = MISSING
    noise: NoiseConfig = MISSING
    scan: ScanConfig = MISSING
    dataset: DatasetConfig = MISSING
    model: ModelConfig = MISSING
    optimizer: OptimizerConfig = MISSING
    training: TrainingConfig = field(default_factory=TrainingConfig)
    parts: PartsConfig = field(default_factory=PartsConfig)

    def __post_init__(self) -> None:
        _check(self.size in SIZES, "size", f"one of {', '.join(SIZES)}", self.size)
        _check(self.seed >= 0, "seed", "a seed of 0 or above", self.seed)
        _check(self.trial >= 0, "trial", "a trial of 0 or above", self.trial)
        _check(self.tolerance_mm > 0, "tolerance_mm", "a positive tolerance in mm", self.tolerance_mm)
        _check(self.timing_repeats >= 1, "timing_repeats", "at least 1", self.timing_repeats)


FILTERS: dict[str, type[FilterConfig]] = {
    node.name: node for node in (StatisticalFilterConfig, RadiusFilterConfig, MedianFilterConfig, AdaptiveFilterConfig)
}
GROUPS: dict[str, type] = {
    "noise": NoiseConfig,
    "scan": ScanConfig,
    "dataset": DatasetConfig,
    "model": ModelConfig,
    "optimizer": OptimizerConfig,
    "training": TrainingConfig,
    "parts": PartsConfig,
}


RETIRED = ("training.log_every",)  # keys of results files made before they were taken away; nothing read them


def from_flat(flat: dict[str, Any]) -> Config:
    """The configuration of a results file's run, from its dotted keys.

    Raises:
        ValueError: If a value is out of range.
        TypeError: If a key is unknown, as in a file that other code wrote.
    """
    nested: dict[str, Any] = {}
    for key, value in flat.items():
        if key in RETIRED:
            continue
        *path, last = key.split(".")
        inner = nested
        for part in path:
            inner = inner.setdefault(part, {})
        inner[last] = value
    own = {each.name for each in fields(FILTERS[nested["filter"]["name"]])}
    # A key that only other filters have, and that was None in all of them, stands among what the runs of a file share.
    nested["filter"] = {key: value for key, value in nested["filter"].items() if key in own or value is not None}
    for group, node in {**GROUPS, "filter": FILTERS[nested["filter"]["name"]]}.items():
        nested[group] = node(**nested.get(group, {}))
    return Config(**nested)


def pretrained(out: str, size: str) -> str:
    """The folder of the newest finished run of experiments.pretrain of a size.

    Raises:
        ValueError: If there is none.
    """
    runs = sorted(Path(out, "pretrain", size).glob("*/run.json"), key=lambda path: path.stat().st_mtime)
    if not runs:
        raise ValueError(f"transfer=modelnet10: expected a run below {out}/pretrain/{size}; "
                         f"run `python -m experiments.pretrain size={size}` first")  # fmt: skip
    return str(runs[-1].parent)


def register() -> None:
    """Make the schema, and the resolvers of conf/, known to Hydra under the names that conf/ uses."""
    OmegaConf.register_new_resolver("is_paper", lambda size: size == "paper", replace=True)
    OmegaConf.register_new_resolver("pretrained", pretrained, replace=True)
    OmegaConf.register_new_resolver("trial_options", tuning.trial_options, replace=True)
    OmegaConf.register_new_resolver("trial_rate", tuning.trial_rate, replace=True)
    OmegaConf.register_new_resolver("tuned_rate", tuning.tuned_rate, replace=True)
    store = ConfigStore.instance()
    store.store(name="schema", node=Config)
    for name, node in FILTERS.items():
        store.store(group="filter", name=f"schema_{name}", node=node)
    for group, node in GROUPS.items():
        if group not in ("training", "parts"):  # set by sizes and experiments, no groups of their own
            store.store(group=group, name=f"schema_{group}", node=node)
