"""What the README shows works: its Python, its command lines, its links and its numbers."""

import re
import shlex
import subprocess
from pathlib import Path

import pytest

from cablejax.cli import main
from experiments import ROOT
from experiments.readme import fill

README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", README, flags=re.DOTALL | re.MULTILINE)


def test_python_examples_run(capsys: pytest.CaptureFixture[str]):
    namespace: dict[str, object] = {}
    for block in blocks("python"):
        exec(compile(block, "README.md", "exec"), namespace)
    assert re.search(r"\d+\.\d\d mm, 95 % interval \d+\.\d\d to \d+\.\d\d", capsys.readouterr().out)


def test_cablejax_commands_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    monkeypatch.chdir(tmp_path)
    commands = [line for block in blocks("sh") for line in block.splitlines() if line.startswith("cablejax ")]
    assert len(commands) >= 2
    for line in commands:
        code = main(shlex.split(line, comments=True)[1:])
        assert code == 0, f"{line}\n{capsys.readouterr().err}"
    assert (tmp_path / "scan.html").stat().st_size > 100_000


def test_experiment_commands_name_what_exists():
    lines = [line for block in blocks("sh") for line in block.splitlines() if line.startswith("python -m ")]
    assert lines
    for line in lines:
        module, *arguments = shlex.split(line, comments=True)[2:]
        assert (ROOT / (module.replace(".", "/") + ".py")).is_file(), line
        for argument in arguments:
            group, _, option = argument.partition("=")
            if (ROOT / "conf" / group).is_dir():
                assert (ROOT / "conf" / group / f"{option}.yaml").is_file(), line


def test_make_targets_exist():
    listed = subprocess.run(["make", "help"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for target in re.findall(r"(?:`|^)make ([a-z0-9_-]+)", README, flags=re.MULTILINE):
        assert re.search(rf"^  {target} ", listed, flags=re.MULTILINE), target


def test_links_lead_somewhere():
    for link in re.findall(r"\]\(([^)#:]+)\)", README):
        assert (ROOT / link).exists(), link


def test_numbers_are_those_of_the_results():
    assert fill(README, ROOT / "results") == README, "stale: run `make figures`"
