"""Build sdist and wheel from what is committed, check both, and write the notes; nothing is uploaded.

    python -m tools.release [--out dist] [--draft]

The wheel is built from the sdist, so that the sdist is whole, and installed into an empty environment, where it simulates a scan
and measures it. Exit code 1 where the repository is not ready (`--draft` passes over that), 2 where a check fails.
"""

import argparse
import base64
import csv
import hashlib
import io
import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import tomllib
import zipfile
from pathlib import Path

from packaging.metadata import Metadata

ROOT = Path(__file__).resolve().parents[1]
HEADING = re.compile(r"^## (.+?)\s*$", re.MULTILINE)
UNRELEASED = "Unreleased"
FOREIGN = re.compile(r"(^|/)(docs|tests|results|runs|notebooks|benchmarks|experiments|_build|\.venv|__pycache__)(/|$)")
USE = """
import cablejax
cablejax.ensure_right_sums()
import jax.numpy as jnp
from cablejax.ops import knn
assert knn(jnp.array([[0.0], [1.0], [3.0]]), k=1).neighbors[:, 0].tolist() == [1, 0, 1]
print(cablejax.__version__)
"""


class ReleaseError(Exception):
    """A check failed; the message is one sentence."""


def sections(changelog: str) -> dict[str, str]:
    """The text under each heading of the second level, by heading, in order."""
    parts = HEADING.split(changelog)
    return {heading: text.strip() for heading, text in zip(parts[1::2], parts[2::2], strict=True)}


def section_of(changelog: str, version: str) -> tuple[str, str] | None:
    """Heading and text of a version: its number, alone or followed by more; None where there is none."""
    found = [(heading, text) for heading, text in sections(changelog).items() if heading.split()[:1] == [version]]
    return found[0] if found else None


def notes(changelog: str, version: str) -> str:
    """What the notes of a version say: its section, or in a draft what is unreleased as well.

    Raises:
        ReleaseError: If the changelog says nothing of it.
    """
    named, unreleased = section_of(changelog, version), sections(changelog).get(UNRELEASED)
    parts = [text for text in (unreleased, named and named[1]) if text]
    if not parts:
        raise ReleaseError(f"CHANGELOG.md: expected a heading that begins with {version}, with something below it")
    return f"# cablejax {version}\n\n" + "\n\n".join(parts) + "\n"


def not_ready(root: Path) -> list[str]:
    """What a person has to do before this can be a release, one sentence each."""
    version = version_of(root)
    changelog = (root / "CHANGELOG.md").read_text(encoding="utf-8")
    package = re.search(r'^__version__ = "(.+)"$', (root / "cablejax/__init__.py").read_text(), re.MULTILINE)
    citation = re.search(r"^version: (.+)$", (root / "CITATION.cff").read_text(encoding="utf-8"), re.MULTILINE)
    named, told = section_of(changelog, version), []
    for name, found in (("cablejax/__init__.py", package), ("CITATION.cff", citation)):
        if found is None or found[1] != version:
            told.append(f"{name}: expected version {version}, got {None if found is None else found[1]}")
    if sections(changelog).get(UNRELEASED):
        told.append(f"CHANGELOG.md: expected what is below {UNRELEASED} to stand below {version}")
    if named is None:
        told.append(f"CHANGELOG.md: expected a heading that begins with {version}")
    elif "unreleased" in named[0].lower():
        told.append(f"CHANGELOG.md: expected a date behind {version}, got {named[0]!r}")
    return told


def version_of(root: Path) -> str:
    """The version that pyproject.toml states."""
    return tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]


def check_sdist(path: Path) -> None:
    """Whether the sdist holds what a build needs and nothing that was built.

    Raises:
        ReleaseError: Naming what is missing or too much.
    """
    with tarfile.open(path) as file:
        names = {name.partition("/")[2] for name in file.getnames()}
    for name in ("pyproject.toml", "README.md", "LICENSE", "cablejax/__init__.py", "cablejax/nets/weights/adgcnn.npz"):
        if name not in names:
            raise ReleaseError(f"{path.name}: expected {name} in it")
    check_own(path, names)


def check_wheel(path: Path, version: str) -> None:
    """Whether the wheel's metadata are valid, its files those that its record lists, and all of them the package's.

    Raises:
        ReleaseError: Naming what is wrong.
    """
    with zipfile.ZipFile(path) as file:
        names = set(file.namelist())
        (folder,) = {name.partition("/")[0] for name in names if name.partition("/")[0].endswith(".dist-info")}
        metadata = Metadata.from_email(file.read(f"{folder}/METADATA"), validate=True)
        record = list(csv.reader(io.StringIO(file.read(f"{folder}/RECORD").decode())))
        wrong = [name for name, digest, _ in record if digest and digest != _digest(file.read(name))]
    if str(metadata.version) != version or metadata.description_content_type != "text/markdown":
        raise ReleaseError(f"{path.name}: expected version {version} and a description in Markdown")
    if wrong or {name for name, *_ in record} != names:
        raise ReleaseError(
            f"{path.name}: expected files as its record lists them; differs: {', '.join(wrong) or names}"
        )
    check_own(path, {name for name in names if not name.startswith(folder)})
    foreign = {name for name in names if not name.startswith(("cablejax/", folder))}
    if foreign:
        raise ReleaseError(f"{path.name}: expected the package alone, got {', '.join(sorted(foreign)[:3])}")


def _digest(content: bytes) -> str:
    return "sha256=" + base64.urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=").decode()


def check_own(path: Path, names: set[str]) -> None:
    """Whether no folder of the repository slipped in that is no part of the package.

    Raises:
        ReleaseError: Naming the first that did.
    """
    foreign = sorted(name for name in names if FOREIGN.search(name))
    if foreign:
        raise ReleaseError(f"{path.name}: expected the package alone, got {foreign[0]}")


def build(root: Path, out: Path) -> tuple[Path, Path]:
    """Sdist and wheel of what is committed.

    Raises:
        ReleaseError: If the build fails.
    """
    out.mkdir(parents=True, exist_ok=True)
    for old in (*out.glob("cablejax-*.tar.gz"), *out.glob("cablejax-*.whl")):
        old.unlink()
    with tempfile.TemporaryDirectory() as folder:
        archive = subprocess.run(["git", "-C", root, "archive", "HEAD"], stdout=subprocess.PIPE, check=True).stdout
        with tarfile.open(fileobj=io.BytesIO(archive)) as file:
            file.extractall(folder, filter="data")
        _run(_uv(), "build", "--quiet", "--no-build-isolation", "--python", sys.executable, "--out-dir", out, folder)
    (sdist,), (wheel,) = out.glob("cablejax-*.tar.gz"), out.glob("cablejax-*.whl")
    return sdist, wheel


def check_installed(wheel: Path, version: str) -> None:
    """Install the wheel with what it asks for into an empty environment, and use it there.

    Raises:
        ReleaseError: If anything of that fails.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _run(_uv(), "venv", "--quiet", "--python", sys.executable, folder / "venv")
        python = folder / "venv" / "bin" / "python"
        _run(_uv(), "pip", "install", "--quiet", "--python", python, wheel)
        told = _run(python, "-I", "-c", USE, cwd=folder)
        if told.strip() != version:
            raise ReleaseError(f"{wheel.name}: expected version {version} once installed, got {told.strip()!r}")
        command = folder / "venv" / "bin" / "cablejax"
        _run(command, "simulate", "scan.ply", "--points", "2000", "--quiet", cwd=folder)
        if "diameter" not in _run(command, "measure", "scan.ply", "--unit", "mm", "--quiet", cwd=folder):
            raise ReleaseError(f"{wheel.name}: expected the installed command to measure its own scan")


def _uv() -> Path:
    return Path(sys.executable).with_name("uv")


def _run(*command: str | Path, cwd: Path | None = None) -> str:
    """Run a command with nothing lent to it; what it printed.

    Raises:
        ReleaseError: With the command's last words where it fails.
    """
    clean = {key: value for key, value in os.environ.items() if key not in ("PYTHONPATH", "PYTHONHOME")}
    done = subprocess.run(command, cwd=cwd, env=clean, capture_output=True, text=True, check=False)
    if done.returncode:
        last = (done.stderr or done.stdout).strip().splitlines()[-1:]
        raise ReleaseError(f"{Path(command[0]).name} {command[1]} failed: {' '.join(last)}")
    return done.stdout


def main() -> None:
    """Build, check, write the notes."""
    parser = argparse.ArgumentParser(prog="python -m tools.release", description="Build and check a release.")
    parser.add_argument("--out", type=Path, default=ROOT / "dist")
    parser.add_argument("--draft", action="store_true", help="exit with 0 although the repository is not ready")
    options = parser.parse_args()
    version, out = version_of(ROOT), options.out.resolve()
    try:
        text = notes((ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), version)
        sdist, wheel = build(ROOT, out)
        check_sdist(sdist)
        check_wheel(wheel, version)
        check_installed(wheel, version)
    except ReleaseError as error:
        print(f"error: {error}", file=sys.stderr)
        shutil.rmtree(out, ignore_errors=True)
        sys.exit(2)
    (out / "notes.md").write_text(text, encoding="utf-8")
    for path in (sdist, wheel, out / "notes.md"):
        print(path)
    told = not_ready(ROOT)
    for sentence in told:
        print(f"not ready: {sentence}", file=sys.stderr)
    sys.exit(bool(told) and not options.draft)


if __name__ == "__main__":
    main()
