"""The order in which results are told, in terminal, README and report alike: one section for each question."""

from collections.abc import Sequence
from pathlib import Path

from experiments.analysis.results import Results
from experiments.display.benchmark_sections import BENCHMARKS
from experiments.display.drawing import Drawing
from experiments.display.filtering import figures as filtering_figures
from experiments.display.filtering import tables as filtering_tables
from experiments.display.measurement import parts_tables, rejection_tables
from experiments.display.networks import attention
from experiments.display.networks import figures as network_figures
from experiments.display.networks import tables as network_tables
from experiments.display.optimizers import figures as optimizer_figures
from experiments.display.optimizers import short, study_figures, study_tables, transfer
from experiments.display.optimizers import tables as optimizer_tables
from experiments.display.section import Section, of
from experiments.display.table import Table

SECTIONS: tuple[Section[Results], ...] = (
    Section(
        Results,
        "Outlier removal",
        "Four filters on one noisy scan: Table 1, and then what the paper could not show: whether the points taken away were "
        "the outliers.",
        ("table1_filtering",),
        (
            of("table1_filtering", filtering_tables.table1),
            of("table1_filtering", filtering_tables.table1_truth),
        ),
        (of("table1_filtering", filtering_figures.removal),),
    ),
    Section(
        Results,
        "Outlier removal, harder scans",
        "The same four filters with up to as many outliers as the paper's filters take points away, and under noise strong "
        "enough for its kinds to differ.",
        ("table1_outliers", "table1_noise"),
        (
            of("table1_outliers", filtering_tables.table1_outliers),
            of("table1_noise", filtering_tables.table1_noise),
        ),
        (of("table1_outliers", filtering_figures.outlier_shares),),
    ),
    Section(
        Results,
        "Adaptive filter",
        "Deviation from the true surface before and after eqs. (2)-(8), and after two variants on the same weights that "
        "do not shrink a convex surface.",
        ("table2_3_deviation",),
        (of("table2_3_deviation", filtering_tables.table2_3),),
        (of("table2_3_deviation", filtering_figures.deviation),),
    ),
    Section(
        Results,
        "Diameter",
        "The diameter of the scan in millimetres with its 95 % interval, and the scan itself.",
        ("diameter",),
        (of("diameter", filtering_tables.diameter),),
        (of("diameter", filtering_figures.scan_views), of("diameter", filtering_figures.section)),
    ),
    Section(
        Results,
        "Networks",
        "AlexNet, VGG-16 and ResNet50 on a depth image and ADGCNN on the points of the same simulated cables, all under "
        "Adadelta; the table tells of how many sizes and epochs each result is.",
        network_tables.NETWORKS,
        (network_tables.networks,),
        (network_figures.accuracy_curves, network_figures.loss_curves, network_figures.confusions),
    ),
    Section(
        Results,
        "Accuracy of ADGCNN",
        "ADGCNN trained twice as long as for Figure 8, and trained on clouds of the hardest kind, each beside a cylinder fit.",
        ("standard_adgcnn", "hard_adgcnn"),
        (network_tables.versions,),
    ),
    Section(
        Results,
        "Finding the cable first",
        "A network that says which points are the cable's, with a cylinder fitted to those, beside fits to all points and to the "
        "true ones.",
        ("rejection", "calibration"),
        (
            of("rejection", rejection_tables.ways),
            of("rejection", rejection_tables.arcs),
            of("calibration", rejection_tables.calibration),
        ),
    ),
    Section(
        Results,
        "Optimizers",
        "A small ADGCNN on simulated cables, trained under Adadelta and four other optimizers at stated learning rates, from "
        "random weights and from weights trained on another set.",
        ("fig13_optimizers", "fig13_transfer", "fig13_short"),
        (
            of("fig13_short", short.table),
            of("fig13_optimizers", optimizer_tables.optimizers),
            of("fig13_transfer", transfer.table),
        ),
        (
            of("fig13_short", short.curve),
            of("fig13_optimizers", optimizer_figures.optimizer_curves),
            of("fig13_transfer", transfer.curves),
        ),
    ),
    Section(
        Results,
        "Optimizers, tuned alike",
        "Seven optimizers, each given the same number of quasi-random trials of its learning rate, chosen on validation, and "
        "Keras' defaults beside them: much of what is said of optimizers is said of learning rates.",
        ("optimizer_search", "optimizer_study"),
        (of("optimizer_search", optimizer_tables.search), of("optimizer_study", optimizer_tables.study)),
        (of("optimizer_search", optimizer_figures.sensitivity), of("optimizer_study", optimizer_figures.study_bars)),
    ),
    Section(
        Results,
        "The study",
        "Nine optimizers, and the network without its parts, on clouds that are new in every epoch, tuned alike over rate "
        "and a second number, by a protocol written before its results (docs/study.md).",
        tuple(study_tables.TITLES),
        tuple(
            of(name, maker)
            for name in study_tables.TITLES
            for maker in (study_tables.arms_table, study_tables.against_table)
        ),
        (*(of(name, study_figures.curves) for name in study_tables.TITLES), study_figures.profiles),
    ),
    Section(
        Results,
        "Ablation",
        "ADGCNN with one part left out, or one setting changed, at a time.",
        ("ablation",),
        (of("ablation", network_tables.ablation),),
    ),
    Section(
        Results,
        "Robustness",
        "The network trained on standard clouds, tested on clouds with more noise, fewer points, holes, and other scanners.",
        ("robustness",),
        (of("robustness", network_tables.robustness),),
        (of("robustness", network_figures.robustness),),
    ),
)

ONE_NETWORK: tuple[Section[Results], ...] = (
    Section(
        Results,
        "Attention",
        "The channel weights that a trained ADGCNN gives to three test cables, and the parts of the surface they favour.",
        ("attention",),
        (),
        (of("attention", attention.surface),),
    ),
    Section(
        Results,
        "Parts",
        "A network that labels the points of a scan by part.",
        ("parts",),
        (of("parts", parts_tables.labels),),
    ),
)
SHOWN = (*SECTIONS, *ONE_NETWORK, *BENCHMARKS)  # in the order of report and notebooks


def all_tables(folder: Path) -> list[Table]:
    """Every table of the experiments that a results folder allows, in order."""
    return [table for section in SECTIONS for table in section.made_tables(folder)]


def all_figures(folder: Path, sections: Sequence[Section] = SECTIONS) -> list[Drawing]:
    """Every figure that a results folder allows, in order."""
    return [drawing for section in sections for drawing in section.made_figures(folder)]
