"""Results files as tables and figures read them: rows chosen by cell, values averaged over seeds."""

from pathlib import Path
from typing import Any

from cablejax.io import read_json
from experiments.analysis.statistics import Estimate, estimate

NAMES = {
    "statistical": "Statistical",
    "radius": "Radius",
    "median": "Median",
    "adaptive": "Adaptive (ours)",
    "gaussian": "Gaussian",
    "random": "Random",
    "compound": "Compound",
    "sgd": "SGD (full set)",
    "mbgd": "Mini-batch SGD",
    "adadelta": "Adadelta",
    "adagrad": "Adagrad",
    "rmsprop": "RMSProp",
    "adam": "Adam",
    "adamw": "AdamW",
    "schedule_free": "Schedule-free AdamW",
    "muon": "Muon",
    "adadelta_paper": "Adadelta, the paper's way",
    "adgcnn": "ADGCNN",
    "adgcnn_fit": "ADGCNN and fit",
    "dgcnn": "DGCNN",
    "pointnet": "PointNet",
    "pointnet2": "PointNet++",
    "pointnext": "PointNeXt-S",
    "alexnet": "AlexNet",
    "vgg16": "VGG-16",
    "resnet50": "ResNet50",
    "full": "Whole network",
    "no_attention": "without attention",
    "no_enhancement": "without enhancement",
    "no_fusion": "without fusion",
    "no_raster": "without enhancement and fusion",
    "fresh": "6,656 clouds, none twice",
    "pool1": "416 clouds, 16 times",
    "pool2": "832 clouds, 8 times",
    "pool4": "1,664 clouds, 4 times",
    "pool8": "3,328 clouds, twice",
}


class Results:
    """One results file, as `experiments.collect` and its likes write it."""

    def __init__(self, raw: dict[str, Any]) -> None:
        self._raw = raw

    @classmethod
    def read(cls, folder: Path, experiment: str) -> "Results | None":
        """Read `<folder>/<experiment>.json`, None where it was not made."""
        path = folder / f"{experiment}.json"
        return cls(read_json(path)) if path.is_file() else None

    @property
    def experiment(self) -> str:
        """Name of the experiment."""
        return self._raw["experiment"]

    @property
    def runs(self) -> list[dict[str, Any]]:
        """One row a run: of a sweep `cell` (what was swept, by dotted key), `seed` and `metrics`."""
        return self._raw["runs"]

    @property
    def shared(self) -> dict[str, Any]:
        """The configuration that all runs share, by dotted key."""
        return self._raw["config"]

    @property
    def size(self) -> str:
        """Size of the runs: smoke, quick or paper."""
        return self._raw["size"]

    @property
    def provenance(self) -> dict[str, Any]:
        """As `cablejax.io.provenance` gives it."""
        return self._raw["provenance"]

    @property
    def seeds(self) -> list[int]:
        """Seeds of the runs."""
        return self._raw["seeds"]

    @property
    def seconds(self) -> float:
        """Of all runs together."""
        return self._raw["seconds"]

    @property
    def code_revision(self) -> str:
        """The code that made the runs; with a `+` where it was not committed."""
        return self._raw["code_revision"]

    @property
    def target(self) -> float:
        """Of a part of the study: the validation accuracy whose first epoch is counted."""
        return self._raw["target"]

    @property
    def own(self) -> str:
        """Of a part of the study: the arm that the others are compared with."""
        return self._raw["own"]

    @property
    def updates_per_epoch(self) -> int:
        """Of a part of the study: updates an epoch of all arms but gradient descent."""
        return self._raw["updates_per_epoch"]

    @property
    def clouds(self) -> list[dict[str, Any]]:
        """Of the attention: one row a test cloud."""
        return self._raw["clouds"]

    @property
    def trained_by(self) -> str:
        """Of the attention: the experiment that trained the network."""
        return self._raw["run"]["experiment"]

    def config(self, key: str) -> Any:
        """A configuration value that all runs share, by its dotted key."""
        return self.shared[key]

    def values(self, key: str) -> list[Any]:
        """The values that a swept key takes, each once, in ascending order; one where it was not swept."""
        found = {row["cell"][key] for row in self.runs if key in row["cell"]}
        return sorted(found) if found else [self.config(key)]

    def config_of(self, key: str, **cell: Any) -> Any:
        """A configuration value of one cell's runs, swept or not."""
        for row in self.runs:
            if key in row["cell"] and self._matches(row, cell):
                return row["cell"][key]
        return self.config(key)

    def _matches(self, row: dict[str, Any], cell: dict[str, Any]) -> bool:
        fixed = self.shared
        wanted = {key.replace("__", "."): value for key, value in cell.items()}
        return all(row["cell"].get(key, fixed.get(key)) == value for key, value in wanted.items())

    def rows(self, **cell: Any) -> list[dict[str, Any]]:
        """Metrics of the runs of one cell; keys are written with `__` for the dot: `filter__name="radius"`."""
        return [row["metrics"] for row in self.runs if self._matches(row, cell)]

    def mean(self, metric: str, **cell: Any) -> Estimate:
        """A metric, dotted where nested, averaged over the seeds of a cell.

        Raises:
            KeyError: If no run is in that cell.
        """
        return estimate(self._numbers(metric, cell))

    def least(self, metric: str, **cell: Any) -> float:
        """The smallest over the seeds of a cell, which is what seconds are: other work on the machine only adds to them.

        Raises:
            KeyError: If no run is in that cell.
        """
        return min(self._numbers(metric, cell))

    def _numbers(self, metric: str, cell: dict[str, Any]) -> list[float]:
        rows = self.rows(**cell)
        if not rows:
            raise KeyError(f"{self.experiment}: no run with {cell}")
        numbers = []
        for row in rows:
            value: Any = row
            for part in metric.split("."):
                value = value[part]
            numbers.append(float(value))
        return numbers
