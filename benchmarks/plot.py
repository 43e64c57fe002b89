"""Draw the benchmark results: `python -m benchmarks.plot` makes results/figures/benchmark_*.png from results/benchmarks/."""

import json
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt

RESULTS = Path("results/benchmarks")
FIGURES = Path("results/figures")


def draw_contenders(table: dict[str, Any], path: Path) -> None:
    """Bars of the medians, ours first, with the quartiles."""
    rows = table["rows"]
    median = [1e3 * row["median_s"] for row in rows]
    low, high = zip(*(row["quartiles_s"] for row in rows), strict=True)
    error = [
        [m - 1e3 * q for m, q in zip(median, low, strict=True)],
        [1e3 * q - m for m, q in zip(median, high, strict=True)],
    ]
    figure, axes = plt.subplots(figsize=(6, 0.5 * len(rows) + 1.2), layout="constrained")
    axes.barh(
        [row["contender"] for row in rows], median, xerr=error, color=["tab:orange"] + ["tab:gray"] * (len(rows) - 1)
    )
    axes.invert_yaxis()
    axes.set_xlabel("ms, median and quartiles")
    axes.set_title(f"{table['title']}, {table['config']['points']:,} points, k = {table['config']['k']}")
    figure.savefig(path, dpi=150)
    plt.close(figure)


def draw_scale(table: dict[str, Any], path: Path) -> None:
    """Seconds and peak memory over the number of points."""
    figure, (time, memory) = plt.subplots(1, 2, figsize=(9, 3.5), layout="constrained")
    for name in dict.fromkeys(row["contender"] for row in table["rows"]):
        rows = [row for row in table["rows"] if row["contender"] == name]
        points = [row["points"] for row in rows]
        time.loglog(points, [row["run_s"] for row in rows], "o-", label=name)
        memory.loglog(points, [row["peak_gb"] for row in rows], "o-", label=name)
    time.set_ylabel("seconds")
    memory.set_ylabel("peak memory of the process, GB")
    for axes in (time, memory):
        axes.set_xlabel("points")
        axes.legend()
    figure.savefig(path, dpi=150)
    plt.close(figure)


def main() -> None:
    """Draw every result that there is."""
    FIGURES.mkdir(parents=True, exist_ok=True)
    for source in sorted(RESULTS.glob("*.json")):
        tables, path = json.loads(source.read_text())["tables"], FIGURES / f"benchmark_{source.stem}.png"
        if source.stem == "scale":
            draw_scale(tables["rows"], path)
        elif "contenders" in tables and "points" in tables["contenders"]["config"]:
            draw_contenders(tables["contenders"], path)
        else:
            continue
        print(path)


if __name__ == "__main__":
    main()
