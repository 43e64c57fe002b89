"""`make NAME` makes the committed file of that name again, with its seeds."""

import re
import shutil
import subprocess

import pytest
from omegaconf import OmegaConf

from cablejax.io import read_json
from experiments import ROOT

MADE = ("table1_filtering", "table2_3_deviation", "diameter", "robustness", "fig5_alexnet", "fig6_vgg16", "fig7_resnet50",
        "fig8_adgcnn", "standard_adgcnn", "hard_adgcnn", "fig13_optimizers", "optimizer_search", "optimizer_study",
        "ablation", "fig13_transfer")  # fmt: skip


def own_seeds(name: str) -> str:
    """The seeds that an experiment's configuration sweeps over, its own or those of what it starts from."""
    config = OmegaConf.load(ROOT / "conf" / "experiment" / f"{name}.yaml")
    found = OmegaConf.select(config, "hydra.sweeper.params.seed")
    return (
        str(found) if found is not None else own_seeds(next(each for each in config.defaults if isinstance(each, str)))
    )


def seeds_of(text: str) -> list[int]:
    """Hydra's `range(3)`, `range(1,4)` or a single number."""
    numbers = [int(each) for each in re.findall(r"\d+", text)]
    return list(range(*numbers)) if "range" in text else numbers


@pytest.mark.skipif(shutil.which("make") is None, reason="no make")
@pytest.mark.parametrize("name", MADE)
def test_make_has_the_seeds_of_the_committed_file(name: str):
    done = subprocess.run(["make", "-n", name], cwd=ROOT, capture_output=True, text=True, check=True)
    command = next(line for line in done.stdout.splitlines() if f"experiment={name} " in line)
    given = re.search(r'"seed=([^"]+)"', command)
    assert seeds_of(given[1] if given else own_seeds(name)) == read_json(ROOT / "results" / f"{name}.json")["seeds"]
