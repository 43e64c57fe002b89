"""`cablejax app` as a command: what it refuses before it opens a page."""

import pytest

from cablejax.cli import main

REFUSED = {
    "a missing file": (["missing.ply"], "missing.ply: does not exist"),
    "a folder": (["."], ".: is a folder; open its scans one by one"),
    "no port": (["--port", "70000"], "--port: expected 0 to 65535, got 70000"),
    "another machine's address": (["--host", "192.0.2.1"], "--host 192.0.2.1 --port 0: "),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_opened_is_told_in_a_sentence(tmp_path, monkeypatch, capsys, case):
    monkeypatch.chdir(tmp_path)
    arguments, sentence = REFUSED[case]
    assert main(["app", "--no-browser", *arguments]) == 1
    assert capsys.readouterr().err.startswith(f"cablejax: {sentence}")
