"""Draw the figures of README, report and notebooks, from results files alone.

python -m experiments.figures --results results --out results/figures
"""

import argparse
from pathlib import Path

from cablejax.io import atomic_write
from cablejax.report import figure_style, png_bytes
from experiments.display.drawing import Drawing
from experiments.display.sections import SHOWN, all_figures


def write_figures(folder: Path, out: Path) -> list[Path]:
    """Draw each figure that a results folder allows and write it as `<out>/<name>.png`."""
    out.mkdir(parents=True, exist_ok=True)
    with figure_style():
        return [_write(drawing, out) for drawing in all_figures(folder, SHOWN)]


def _write(drawing: Drawing, out: Path) -> Path:
    path = out / f"{drawing.name}.png"
    with atomic_write(path) as file:
        file.write(png_bytes(drawing.figure))
    return path


def main() -> None:
    """Write every figure that can be made."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.figures", description="Draw figures from results files."
    )
    parser.add_argument("--results", type=Path, default=Path("results"))
    parser.add_argument("--out", type=Path, default=Path("results/figures"))
    options = parser.parse_args()
    for path in write_figures(options.results, options.out):
        print(path)


if __name__ == "__main__":
    main()
