"""The main job: clean and measure a 53,135-point scan, train a network for a short while, and report.

    python -m experiments.main [--size quick] [--out runs]

Each stage is the very Hydra sweep that a researcher would run by hand, in a process of its own; where there are two cores the
training runs beside the others, each on its share. What a killed run finished is not done again: the same command goes on.
"""

import argparse
import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from experiments import ROOT, collect, figures, report
from experiments.display.sections import all_tables
from experiments.harness.revision import code_revision
from experiments.study import usable_cores

INTERRUPTED = 130


@dataclass(frozen=True)
class Stage:
    """One sweep of the main job."""

    experiment: str
    module: str
    about: str
    overrides: tuple[str, ...] = ()


# One seed each: the committed results have more.
STAGES = (
    Stage(
        "table1_filtering", "experiments.table1_filtering", "four filters, three kinds of noise (Table 1)", ("seed=0",)
    ),
    Stage(
        "table2_3_deviation",
        "experiments.table2_3_deviation",
        "deviation before and after (Tables 2 and 3)",
        ("seed=0",),
    ),
    Stage("diameter", "experiments.diameter", "the diameter in millimetres", ("seed=0",)),
)
TRAINING = Stage(
    "fig13_short", "experiments.train", "a short training of ADGCNN under Adadelta (Figure 13)", ("seed=0",)
)


def command(stage: Stage, *, size: str, out: Path) -> list[str]:
    """The sweep of a stage."""
    overrides = [f"experiment={stage.experiment}", f"size={size}", f"out={out}", *stage.overrides]
    return [sys.executable, "-m", stage.module, "-m", *overrides]


def check(stage: Stage, code: int) -> None:
    """End with a stage's own code where it failed.

    Raises:
        SystemExit: Then.
    """
    if code:
        print(f"error: stage {stage.experiment} failed; mended, the same command goes on from here", file=sys.stderr)
        sys.exit(code)


def run_stages(*, size: str, out: Path) -> None:
    """Run every stage's sweep, the training beside the others where there are two cores.

    Raises:
        SystemExit: With a sweep's own code if it fails.
    """
    beside = len(usable_cores()) > 1
    environment = {**os.environ, **({"NPROC": "1", "OMP_NUM_THREADS": "1"} if beside else {})}
    print(
        f"[1/{len(STAGES) + 1}] {TRAINING.experiment}: {TRAINING.about}" + (", beside the others" if beside else ""),
        flush=True,
    )
    training = subprocess.Popen(command(TRAINING, size=size, out=out), cwd=ROOT, env=environment)
    try:
        if not beside:
            check(TRAINING, training.wait())
        for i, stage in enumerate(STAGES, start=2):
            print(f"[{i}/{len(STAGES) + 1}] {stage.experiment}: {stage.about}", flush=True)
            check(
                stage,
                subprocess.run(command(stage, size=size, out=out), cwd=ROOT, env=environment, check=False).returncode,
            )
        check(TRAINING, training.wait())
    finally:
        if training.poll() is None:
            training.terminate()
            training.wait()
    for stage in (*STAGES, TRAINING):
        collect.collect(
            stage.experiment,
            size=size,
            runs=out,
            out=results_folder(size, out),
            revision=code_revision(),
            allow_dirty=True,
        )


def results_folder(size: str, out: Path) -> Path:
    """Where the main job folds its runs: apart from the committed results."""
    return out / f"{size}-results"


def run(*, size: str, out: Path) -> Path:
    """Run every stage, print the tables, write figures and report.

    Returns:
        The report's path.
    """
    start = time.perf_counter()
    run_stages(size=size, out=out)
    folder = results_folder(size, out)
    print("\n" + "\n\n".join(table.to_text() for table in all_tables(folder)))
    print("\nFigures:")
    for path in figures.write_figures(folder, folder / "figures"):
        print(f"  {path}")
    print(f"TensorBoard logs: tensorboard --logdir {out / TRAINING.experiment / size}")
    path = report.write(folder, out / f"{size}-report.html")
    print(f"Done in {time.perf_counter() - start:.0f} s. The report:")
    return path.resolve()


def main() -> None:
    """Command line of the main job."""
    parser = argparse.ArgumentParser(prog="python -m experiments.main", description="Clean, measure, train, report.")
    parser.add_argument("--size", default="quick", choices=("smoke", "quick", "paper"))
    parser.add_argument("--out", type=Path, default=ROOT / "runs")
    options = parser.parse_args()
    try:
        print(run(size=options.size, out=options.out.resolve()))
    except KeyboardInterrupt:
        print("\nInterrupted. The same command goes on from here.", file=sys.stderr)
        sys.exit(INTERRUPTED)


if __name__ == "__main__":
    main()
