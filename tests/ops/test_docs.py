"""The examples of docs/ops.md run, and give what they say."""

import doctest
from pathlib import Path

DOCS = Path(__file__).resolve().parents[2] / "docs" / "ops.md"


def test_examples_of_the_page_run():
    done = doctest.testfile(str(DOCS), module_relative=False)
    assert done.attempted > 15
    assert done.failed == 0
