"""What a program that uses jax does first: `cablejax` and the experiments do, `import cablejax` does not."""

import sys
from collections.abc import Callable

from cablejax.compiled import keep_compiled
from cablejax.jax_sums import check_sums, set_flag, warn_where_wrong

_WAITING: list[Callable[[], None]] = []


def set_up_jax() -> None:
    """Right sums, and compiled programs kept. Before jax computes anything; `jax_sums.check_sums` may follow."""
    set_flag()
    keep_compiled()


def set_up_jax_when_used() -> None:
    """`set_up_jax` and `check_sums` once a part of cablejax needs jax, whose import alone takes a second or two.

    Raises:
        WrongSumsError: Then, or now where jax is in use already.
    """
    if "cablejax.types" in sys.modules:
        _checked()
    else:
        _WAITING.append(_checked)


def in_use() -> None:
    """Do what waits for jax. `cablejax.types` calls it, which every part that computes with jax imports before."""
    while _WAITING:
        _WAITING.pop()()
    warn_where_wrong()


def _checked() -> None:
    set_up_jax()
    check_sums()
