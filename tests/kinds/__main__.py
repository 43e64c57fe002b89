"""Faults of whole kinds, each a module of cases; run them all and count.

python -m tests.kinds
"""

import sys
from collections import Counter
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent


class _Counted:
    """Outcomes by module."""

    def __init__(self) -> None:
        self.outcomes: Counter[tuple[str, str]] = Counter()

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.when == "call" or (report.when == "setup" and not report.passed):
            self.outcomes[Path(report.location[0]).stem, report.outcome] += 1


def main() -> int:
    """Run the cases of every kind; a line a kind."""
    counted = _Counted()
    code = pytest.main([str(HERE), "-q", *sys.argv[1:]], plugins=[counted])
    for path in sorted(HERE.glob("test_*.py")):
        numbers = {outcome: counted.outcomes[path.stem, outcome] for outcome in ("passed", "failed", "skipped")}
        first = path.read_text(encoding="utf-8").split('"""')[1].splitlines()[0]
        told = ", ".join(f"{number} {outcome}" for outcome, number in numbers.items() if number)
        sys.stdout.write(f"{path.stem.removeprefix('test_'):<12} {told}: {first}\n")
    return int(code)


if __name__ == "__main__":
    sys.exit(main())
