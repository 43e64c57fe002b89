"""One self-contained HTML page of everything in a results folder.

python -m experiments.report --results results --out report.html
"""

import argparse
from pathlib import Path

from cablejax.io import atomic_write
from cablejax.report import Page, figure_style, point_scene
from experiments.analysis.results import Results
from experiments.display.claims import verdict_table
from experiments.display.filtering.figures import scan_clouds
from experiments.display.section import Section
from experiments.display.sections import SECTIONS, SHOWN

INTRODUCTION = (
    "Made from results files alone. Every number states the size of its run and its seeds; where the paper gives a number, it "
    "stands beside ours. The paper's scan and training data are not published: the scans here are simulated, with known truth, "
    "so agreement in kind is all that can be asked."
)


def build(folder: Path) -> Page:
    """Tables, figures, verdicts and provenance of every results file in the folder.

    Raises:
        FileNotFoundError: If the folder holds no results file.
    """
    page = Page("cablejax: results", subtitle="Cable point clouds from scan to diameter and size class")
    page.text(INTRODUCTION)
    everything: dict[str, Results] = {}
    for section in SECTIONS:
        everything |= section.read(folder)
    if not everything:
        raise FileNotFoundError(f"{folder}: no results file; run `make run` or collect an experiment first")
    for section in SHOWN:
        _add_section(page, section, folder)
    claims = verdict_table(folder)
    if claims is not None:
        page.section("Verdicts", "What the paper claims, and whether it holds here.")
        page.table(claims.header, claims.rows, caption=claims.caption)
    _add_provenance(page, everything)
    return page


def _add_section(page: Page, section: Section, folder: Path) -> None:
    found = section.read(folder)
    if not found:
        return
    page.section(section.title, section.text)
    for table in section.made_tables(folder):
        page.table(table.header, table.rows, caption=f"{table.title}. {table.caption}", groups=table.groups)
    with figure_style():
        for drawing in section.made_figures(folder):
            page.figure(drawing.figure, alt=drawing.alt, caption=drawing.caption)
    if isinstance(scan := found.get("diameter"), Results):
        clouds, look = scan_clouds(scan)
        page.scene(
            point_scene(clouds, **look),
            caption="The same scan to turn and zoom, thinned. Colour: signed distance to the true surface.",
        )


def _add_provenance(page: Page, found: dict[str, Results]) -> None:
    page.section("Provenance", "Which code made the numbers, on what, from which seeds.")
    rows = []
    for name, results in found.items():
        revision = results.code_revision
        code = revision[:12] + (" + uncommitted" if "+" in revision else "")
        seeds = ", ".join(map(str, results.seeds))
        rows.append([name, results.size, seeds, len(results.runs), f"{results.seconds:,.0f}", code])
    page.table(
        ["Experiment", "size", "seeds", "runs", "seconds", "code revision"], rows, caption="One row per results file."
    )
    details = next(iter(found.values())).provenance
    flat = [[key, _plain(value)] for key, value in details.items()]
    page.table(["Environment", "value"], flat, caption="As recorded by the first experiment.")


def _plain(value: object) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{k} {_plain(v)}" for k, v in value.items())
    if isinstance(value, list):
        return ", ".join(map(_plain, value))
    return str(value)


def write(folder: Path, out: Path) -> Path:
    """Write the report of a results folder as one HTML file."""
    out.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(out) as file:
        file.write(build(folder).render().encode())
    return out


def main() -> None:
    """Write the report."""
    parser = argparse.ArgumentParser(
        prog="python -m experiments.report", description="Make the HTML report from results files."
    )
    parser.add_argument("--results", type=Path, default=Path("results"))
    parser.add_argument("--out", type=Path, default=Path("runs/report.html"))
    options = parser.parse_args()
    print(write(options.results, options.out))


if __name__ == "__main__":
    main()
