"""Tables, figures, verdicts and report from results files of small runs: everything is shown, nothing is left empty."""

import itertools
import shutil
from pathlib import Path

import pytest

from cablejax.io import write_json
from experiments import figures, readme, report
from experiments.analysis import rules
from experiments.display import sections
from experiments.display.claims import CLAIMS, SUPERSEDED, verdict_table
from experiments.display.filtering import paper_layout as paper_tables
from experiments.display.networks import tables as network_tables
from experiments.display.table import Table
from experiments.material.study_plan import PARTS
from tests.experiments.test_study import folded

OPTIMIZERS = ("adadelta", "sgd", "mbgd", "adagrad", "rmsprop", "adam", "adamw")
SIZES = ["25", "150", "630"]


def epoch(number: int, accuracy: float) -> dict[str, float]:
    loss = 2.0 / number
    return {"epoch": number, "train_loss": loss, "validation_loss": 1.1 * loss, "validation_overall": accuracy,
            "validation_class_average": accuracy, "seconds": 1.0}  # fmt: skip


def trained(accuracy: float, rate: float) -> dict[str, object]:
    return {
        "history": [epoch(i + 1, accuracy * (i + 1) / 6) for i in range(6)],
        "learning_rate": rate,
        "validation_overall": accuracy,
        "test_overall": accuracy,
        "test_class_average": accuracy,
        "baseline_overall": 0.5,
        "baseline_class_average": 0.5,
        "test_confusion": [[4, 0, 0], [1, 3, 0], [0, 0, 4]],
        "labels_mm2": SIZES,
        "compile_seconds": 3.0,
        "train_seconds": 6.0,
    }


def results_file(folder: Path, name: str, config: dict, runs: list[dict]) -> None:
    fixed = {"dataset.sizes_mm2": [25, 150, 630], "dataset.n_points": 128, "dataset.version": "standard",
             "dataset.train_per_class": 8, "training.batch_size": 8, "training.epochs": 6, "tolerance_mm": 0.1,
             "scan.n_points": 3000, **config}  # fmt: skip
    write_json(folder / f"{name}.json", {
        "experiment": name, "size": "smoke", "seeds": [0, 1], "code_revision": "abc", "seconds": 9.0,
        "provenance": {"python": "3.11"}, "config": fixed, "runs": runs,
    })  # fmt: skip


def runs(cells: list[tuple[dict, dict]]) -> list[dict]:
    return [{"cell": cell, "seed": seed, "metrics": metrics} for cell, metrics in cells for seed in (0, 1)]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A results folder with one small file for every experiment but `diameter`."""
    out = tmp_path_factory.mktemp("results")
    cleaned = {"remaining": 2900, "seconds": 0.2, "compile_seconds": 1.0, "precision": 0.97, "recall": 0.9, "f1": 0.93,
               "rms_mm": 0.2, "diameter_bias_mm": -0.01}  # fmt: skip
    grid = itertools.product(("statistical", "radius", "median", "adaptive"), ("gaussian", "random", "compound"))
    results_file(out, "table1_filtering", {}, runs([({"filter.name": f, "noise.kind": n}, cleaned) for f, n in grid]))
    grid = itertools.product(("statistical", "radius", "median", "adaptive"), (0.02, 0.4))
    cells = [({"filter.name": f, "scan.outlier_fraction": share}, cleaned) for f, share in grid]
    results_file(out, "table1_outliers", {"scan.n_points": 5000}, runs(cells))
    impulses: dict[str, dict] = {n: {"impulses_removed": 0.7} for n in ("random", "compound")} | {"gaussian": {}}
    grid = itertools.product(("statistical", "radius", "median", "adaptive"), (60.0, 20.0), impulses)
    cells = [({"filter.name": f, "noise.snr_db": snr, "noise.kind": n}, cleaned | impulses[n]) for f, snr, n in grid]
    results_file(out, "table1_noise", {"scan.n_points": 5000}, runs(cells))
    deviation = {
        "before": {"mean_mm": -0.05, "std_mm": 0.38, "within_percent": 21.0},
        "after": {"mean_mm": -0.11, "std_mm": 0.14, "within_percent": 44.0},
        "diameter_bias_mm": -0.2,
    }
    grid = itertools.product((60.0, 80.0, 100.0, 120.0), (0, 1, 2))
    cells = [({"noise.snr_db": snr, "filter.order": order}, deviation) for snr, order in grid]
    results_file(out, "table2_3_deviation", {}, runs(cells))
    for i, (name, model) in enumerate(
        (("fig5_alexnet", "alexnet"), ("fig6_vgg16", "vgg16"), ("fig7_resnet50", "resnet50"), ("fig8_adgcnn", "adgcnn"))
    ):
        results_file(out, name, {"model.name": model}, runs([({}, trained(0.6 + 0.1 * i, 1.0))]))
    optimizers = [({"optimizer.name": name, "optimizer.learning_rate": 0.1}, trained(0.8, 0.1)) for name in OPTIMIZERS]
    results_file(out, "fig13_optimizers", {}, runs(optimizers[:5]))
    starts = [
        ({**cell, "transfer": start}, m)
        for (cell, m), start in itertools.product(optimizers[:5], ("none", "modelnet10"))
    ]
    results_file(out, "fig13_transfer", {}, runs(starts))
    results_file(out, "optimizer_search", {}, runs(optimizers))
    tuned = [({**cell, "rates": rates}, m) for (cell, m), rates in itertools.product(optimizers, ("tuned", "keras"))]
    results_file(out, "optimizer_study", {}, runs(tuned))
    results_file(out, "ablation", {}, runs([({"variant": v}, trained(0.7, 1.0)) for v in network_tables.VARIANTS]))
    conditions = [
        {"kind": kind, "level": level, "network": 0.5, "fit": 0.4}
        for kind in ("noise_mm", "kept", "hole_mm", "arc_deg")
        for level in (0.0, 1.0)
    ]
    results_file(out, "standard_adgcnn", {"model.name": "adgcnn"}, runs([({}, trained(0.9, 1.0))]))
    results_file(out, "hard_adgcnn", {"model.name": "adgcnn"}, runs([({}, trained(0.2, 2.0))]))
    results_file(out, "fig13_short", {}, [{"cell": {}, "seed": 0, "metrics": trained(0.9, 1.0)}])
    for part in PARTS:
        folded(out, part)
    results_file(out, "robustness", {}, runs([({}, {"conditions": conditions})]))
    told = {"accuracy": 0.7, "within_one": 0.9, "median_error_mm": 0.6}
    arcs = [{"from_deg": 0, "to_deg": 80, "clouds": 9, "adgcnn_fit": 0.5, "likelihood": 0.6}]
    tested = {"clouds": 9, "iou_cable": 0.9, "by_arc": arcs, "reliability": {"called_90": 0, "called_90_right": 0}}
    tested |= dict.fromkeys(("all", "kept", "true", "adgcnn_fit", "likelihood"), told)
    cells = [{"dataset": "hard", "n_points": n, "seed": seed} for n in (512, 1024) for seed in (0, 1)]
    results_file(out, "rejection", {}, [cell | tested for cell in cells])
    bins = [{"sure": 0.9, "right": 0.8, "clouds": 9}]
    sure = {"called_90": 5, "called_90_right": 4, "expected_calibration_error": 0.1, "bins": bins}
    judged = {f"{name}_{when}": sure for name in ("validation", "test", "new") for when in ("before", "after")}
    results_file(out, "calibration", {}, [{"seed": seed, "temperature": 0.9, **judged} for seed in (0, 1)])
    return out


def test_every_section_makes_its_tables_and_figures(folder: Path, tmp_path: Path):
    names = {name for section in sections.SECTIONS for name in section.names}
    assert names == {path.stem for path in folder.glob("*.json")} | {"diameter"}
    expected = sum(len(section.tables) for section in sections.SECTIONS if section.names != ("diameter",))
    expected -= 1  # gradient descent by updates has nobody to be compared with
    tables = sections.all_tables(folder)
    assert len(tables) == expected
    for table in tables:
        assert all(len(row) == len(table.header) for row in table.rows), table.title
        assert "nan" not in table.to_text(), table.title
    paths = figures.write_figures(folder, tmp_path)
    assert all(path.read_bytes()[:4] == b"\x89PNG" for path in paths)


@pytest.mark.parametrize(
    ("stages", "word"),
    # Of the study every arm of made-up training is alike; of the older runs there are two seeds.
    [((), "not reproduced"), (("search",), "inconclusive")],
)
def test_every_claim_gets_one_verdict(stages: tuple[str, ...], word: str, folder: Path, tmp_path: Path):
    """The study's where its final runs are complete, until then that of the older runs."""
    if stages:
        shutil.copytree(folder, tmp_path, dirs_exist_ok=True)
        for part in PARTS:
            folded(tmp_path, part, stages=stages)
    table = verdict_table(tmp_path if stages else folder)
    assert table is not None
    assert len(table.rows) == len(CLAIMS) - len(SUPERSEDED)
    verdicts = {row[0]: row[2] for row in table.rows}
    assert set(verdicts.values()) <= set(rules.WORDS)
    assert verdicts["Figures 5-8: ADGCNN is more accurate than AlexNet, VGG-16 and ResNet50"] == word
    assert verdicts["Tables 2-3: the mean deviation goes from -0.2959 mm to 0.0008 mm"] == "not reproduced"


def test_claims_without_results_are_left_out(tmp_path: Path):
    assert verdict_table(tmp_path) is None
    assert sections.all_tables(tmp_path) == []


def test_paper_tables_have_the_papers_layout(folder: Path):
    first, second, third = paper_tables.paper_tables(folder)
    assert [row[0] for row in first.rows][-1] == "The algorithm of this article"
    assert first.rows[0][1] == "2,900 (33,442)"
    assert first.rows[0][-1] == "0.200 (0.295)"
    assert second.rows[-1] == ["Mean", "-0.0500 (-0.2959)", "0.3800 (0.3851)", "21.00% (16.78%)"]
    assert third.rows[0][2] == "0.1400 (0.2229)"


def test_report_and_readme_hold_every_table(folder: Path):
    page = report.build(folder).render()
    text = readme.fill("<!-- made: sections -->\n<!-- end -->", folder)
    for table in sections.all_tables(folder):
        assert f"### {table.title}\n" in text
    for section in sections.SECTIONS:
        if section.names != ("diameter",):
            assert f">{section.title}</h2>" in page


def test_group_names_stand_over_their_columns_and_in_markdown():
    table = Table("T", ["Filter", "points", "s"], [["a", "1", "2"]], "c", groups=[("", 1), ("Gaussian noise", 2)])
    lines = table.to_text().splitlines()
    assert lines[1].strip() == "Gaussian noise"
    assert max(map(len, lines[1:4])) == len(lines[2])
    assert table.to_markdown().splitlines()[0] == "| Filter | Gaussian noise: points | Gaussian noise: s |"
