"""How far a batch is: a bar on a terminal, a line a scan elsewhere, both with the time left."""

import argparse
import time

from cablejax.cli.scans import say


class Progress:
    """Counts scans as they are done.

    Args:
        options: Of the command; nothing is said with `--quiet`.
        total: Scans to do now.
    """

    def __init__(self, options: argparse.Namespace, total: int):
        from tqdm import tqdm

        self._options, self._total, self._done, self._start = options, total, 0, time.monotonic()
        self._bar = tqdm(total=total, unit="scan", disable=True if options.quiet else None)

    def step(self, text: str) -> None:
        """One more is done."""
        self._done += 1
        if not self._bar.disable:
            self._bar.set_postfix_str(text)
            self._bar.update()
            return
        left = (time.monotonic() - self._start) / self._done * (self._total - self._done)
        say(self._options, f"{self._done} of {self._total}, {in_words(left)} left: {text}")

    def close(self) -> None:
        """Leave the bar as it is."""
        self._bar.close()


def in_words(seconds: float | int) -> str:
    """A duration to two figures or so.

    Example:
        >>> [in_words(s) for s in (4.2, 90, 600, 20_000)]
        ['4 s', '90 s', '10 min', '5.6 h']
    """
    if seconds < 120:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"
