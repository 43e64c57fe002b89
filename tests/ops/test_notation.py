"""One way to cite the paper: eq. (5), eqs. (2)-(8)."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = [
    *(ROOT / "cablejax").rglob("*.py"),
    *(ROOT / "docs").glob("*.md"),
    *(ROOT / "conf").rglob("*.yaml"),
    ROOT / "PAPER.md",
]
OTHER = re.compile(
    r"(?<!-)\b(equations?\s*\(?\d|equations? \(|eqs?\.? ?\d|eqs? \(|eqn)", re.IGNORECASE
)  # -eq 1 is the shell's


@pytest.mark.parametrize("path", sorted(PAGES), ids=lambda p: str(p.relative_to(ROOT)))
def test_equations_are_cited_in_one_way(path):
    assert OTHER.findall(path.read_text()) == []


@pytest.mark.parametrize("wrong", ["equation (5)", "Equations (2)-(8)", "eq 5", "eq. 5", "Eq (5)"])
def test_other_ways_are_seen(wrong):
    assert OTHER.search(wrong)


@pytest.mark.parametrize("right", ["eq. (5)", "Eqs. (2)-(8)", "equal to 5", "eqs. (6) and (7)"])
def test_the_one_way_is_not(right):
    assert not OTHER.search(right)
