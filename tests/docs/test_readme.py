"""What the README shows works: its Python, its command lines, its length."""

import re
import shlex
from pathlib import Path

import pytest

from cablejax.cli import main
from experiments import ROOT

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


def test_it_is_read_in_a_few_minutes():
    assert len(re.findall(r"\w+[\w.'/-]*", README)) < 1600
