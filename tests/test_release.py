"""What a release is held to before it is built; the build itself is `make release`."""

import io
import shutil
import tarfile
from pathlib import Path

import pytest

from tools.release import ROOT, ReleaseError, check_own, check_sdist, not_ready, notes, sections

CHANGELOG = "# Changelog\n\n## Unreleased\n\n- new\n\n## 0.2.0 (2026-01-01)\n\n- second\n\n## 0.1.0\n\n- first\n"


def test_notes_are_the_versions_own_section_and_what_is_unreleased():
    assert list(sections(CHANGELOG)) == ["Unreleased", "0.2.0 (2026-01-01)", "0.1.0"]
    assert notes(CHANGELOG, "0.1.0") == "# cablejax 0.1.0\n\n- new\n\n- first\n"
    assert notes(CHANGELOG.replace("## Unreleased\n\n- new\n\n", ""), "0.2.0") == "# cablejax 0.2.0\n\n- second\n"
    with pytest.raises(ReleaseError, match=r"CHANGELOG\.md: expected a heading that begins with 3\.0"):
        notes("# Changelog\n\n## 0.3.0\n\n- third\n", "3.0")


@pytest.fixture
def repository(tmp_path: Path) -> Path:
    """A copy of the files that state the version, ready for a release."""
    (tmp_path / "cablejax").mkdir()
    for name in ("pyproject.toml", "CITATION.cff", "cablejax/__init__.py"):
        shutil.copy(ROOT / name, tmp_path / name)
    (tmp_path / "CHANGELOG.md").write_text("# Changelog\n\n## 0.1.0 (2026-01-01)\n\n- first\n")
    return tmp_path


def test_a_repository_whose_versions_agree_is_ready(repository: Path):
    assert not_ready(repository) == []


@pytest.mark.parametrize(
    ("file", "old", "new", "words"),
    [
        ("CITATION.cff", "version: 0.1.0", "version: 0.0.9", "CITATION.cff: expected version 0.1.0, got 0.0.9"),
        ("cablejax/__init__.py", '__version__ = "0.1.0"', "", "cablejax/__init__.py: expected version 0.1.0, got None"),
        ("CHANGELOG.md", "## 0.1.0", "## Unreleased\n\n- more\n\n## 0.1.0", "expected what is below Unreleased"),
        ("CHANGELOG.md", "(2026-01-01)", "(unreleased)", "expected a date behind 0.1.0"),
        ("CHANGELOG.md", "0.1.0", "0.1.1", "expected a heading that begins with 0.1.0"),
    ],
)
def test_what_is_not_ready_is_said(repository: Path, file: str, old: str, new: str, words: str):
    text = (repository / file).read_text(encoding="utf-8")
    assert old in text
    (repository / file).write_text(text.replace(old, new), encoding="utf-8")
    (told,) = not_ready(repository)
    assert words in told


@pytest.mark.parametrize("name", ["docs/_build/html/index.html", "tests/test_a.py", "cablejax/__pycache__/a.pyc"])
def test_what_is_no_part_of_the_package_is_refused(name: str):
    check_own(Path("cablejax-1.whl"), {"cablejax/ops/knn.py", "cablejax/report/templates/page.html.jinja"})
    with pytest.raises(ReleaseError, match="expected the package alone"):
        check_own(Path("cablejax-1.whl"), {"cablejax/ops/knn.py", name})


def test_an_sdist_without_the_weights_is_refused(tmp_path: Path):
    path = tmp_path / "cablejax-0.1.0.tar.gz"
    with tarfile.open(path, "w:gz") as file:
        for name in ("pyproject.toml", "README.md", "LICENSE", "cablejax/__init__.py"):
            file.addfile(tarfile.TarInfo(f"cablejax-0.1.0/{name}"), io.BytesIO())
    with pytest.raises(ReleaseError, match=r"expected cablejax/nets/weights/adgcnn\.npz"):
        check_sdist(path)
