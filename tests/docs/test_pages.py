"""What README, CONTRIBUTING and the pages of docs/ say is there: links, files, commands, targets, and the numbers of results/."""

import re
import shlex
import subprocess
from pathlib import Path

import pytest

from experiments import ROOT
from experiments.readme import PAGES, block, fill

TEXTS = {
    str(path.relative_to(ROOT)): path.read_text(encoding="utf-8")
    for path in sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md"), *(ROOT / "docs" / "tutorials").glob("*.md")])
}
FOLDERS = "cablejax|experiments|conf|tests|docs|results|benchmarks|tools|requirements"
PLACEHOLDER = re.compile(r"NAME|[*<>{}]|\.\.\.")
MADE = ("docs/notebooks/", "docs/reference/", "docs/_build", "results/study")  # by the build, by runs still to come
each_page = pytest.mark.parametrize("page", TEXTS)


def commands(text: str) -> list[list[str]]:
    """Lines `python -m module argument ...` of a page's blocks and inline code."""
    whole = text.replace("\\\n", " ")
    lines = re.findall(r"^(?:!|    )?python -m (.+)$|`python -m ([^`\n]+)`", whole, flags=re.MULTILINE)
    found = [shlex.split(first or second, comments=True) for first, second in lines]
    return [command for command in found if command and not PLACEHOLDER.search(command[0])]


@each_page
def test_links_lead_somewhere(page: str):
    folder = (ROOT / page).parent
    for link in re.findall(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)", TEXTS[page]):
        target = (folder / link).resolve()
        if not str(target.relative_to(ROOT)).startswith(MADE):
            assert target.exists() or target.with_suffix(".md").exists(), link


@each_page
def test_files_that_are_named_exist(page: str):
    if page == "CHANGELOG.md":
        return  # of versions that were
    for name in re.findall(rf"`((?:{FOLDERS})/[\w./-]+\.\w+)`", TEXTS[page]):
        if not PLACEHOLDER.search(name) and not name.startswith(MADE):
            assert (ROOT / name).exists(), name


def test_files_on_the_paths_of_the_architecture_exist():
    named = set(re.findall(r"`([\w/]+\.py)`", TEXTS["docs/architecture.md"]))
    assert len(named) > 25
    for name in named:
        assert any((ROOT / folder / name).is_file() for folder in ("", "cablejax/measure", "cablejax/ops/neighbors")), (
            name
        )


@each_page
def test_experiment_commands_name_what_exists(page: str):
    for module, *arguments in commands(TEXTS[page]):
        place = ROOT / module.replace(".", "/")
        if not module.startswith(("experiments", "benchmarks", "tests", "tools")):
            continue
        assert place.with_suffix(".py").is_file() or (place / "__main__.py").is_file(), module
        for argument in arguments:
            group, _, option = argument.partition("=")
            if (ROOT / "conf" / group).is_dir() and not PLACEHOLDER.search(option):
                assert all((ROOT / "conf" / group / f"{each}.yaml").is_file() for each in option.split(",")), argument


def test_commands_are_found():
    text = "`python -m a.b c=1`\n\n    python -m d e\n!python -m f  # why\n`python -m NAME x`\n"
    assert commands(text) == [["a.b", "c=1"], ["d", "e"], ["f"]]


@pytest.fixture(scope="module")
def targets() -> set[str]:
    listed = subprocess.run(["make", "help"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    makefile = (ROOT / "Makefile").read_text()
    return set(re.findall(r"^  ([\w-]+) ", listed, flags=re.MULTILINE)) | set(
        re.findall(r"^([a-z][\w-]*):", makefile, flags=re.MULTILINE)
    )


@each_page
def test_make_targets_exist(page: str, targets: set[str]):
    for target in re.findall(r"(?:`|^)make ([a-z][a-z0-9_-]*)", TEXTS[page], flags=re.MULTILINE):
        assert target in targets, target


@pytest.mark.parametrize("page", PAGES)
def test_numbers_are_those_of_the_results(page: str):
    assert fill(TEXTS[page], ROOT / "results") == TEXTS[page], "stale: run `make figures`"


def test_a_changed_number_is_noticed():
    page = re.sub(r"0\.990(?!.*0\.990)", "0.991", TEXTS["README.md"], flags=re.DOTALL)
    assert page != TEXTS["README.md"]
    assert fill(page, ROOT / "results") == TEXTS["README.md"]


def test_markers_must_be_there_and_name_something():
    with pytest.raises(ValueError, match="expected the markers"):
        fill("# A page\n", ROOT / "results")
    with pytest.raises(ValueError, match="made: nonsense: expected one of"):
        block("nonsense", ROOT / "results")


def test_every_page_of_the_site_has_a_title():
    for page, text in TEXTS.items():
        assert re.search(r"^# |\{include\}", text, flags=re.MULTILINE), page


def test_the_guide_names_files_for_each_kind_of_addition():
    guide = TEXTS["CONTRIBUTING.md"]
    for kind in ("A filter", "A network", "An optimizer", "An experiment", "A file format"):
        section = guide.split(f"## {kind}\n")[1].split("\n## ")[0]
        named = [Path(name) for name in re.findall(rf"`((?:{FOLDERS})/[\w./-]+)`", section)]
        assert len([name for name in named if (ROOT / name).exists()]) >= 4, kind
