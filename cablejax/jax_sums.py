"""Sums that jax gets wrong on the CPU from 0.10.2 on, and the XLA flag that puts them right.

The CPU backend of these releases hands a matrix product and the sum after it to a fusion of its own, which drops three
quarters of the terms: 131,076 for 524,304 in `tests/test_jax_versions.py` (jax issue 39103). With the list of such fusions
empty the sums are right. XLA reads the flag once, when its backend starts, and aborts the process on a flag that it does
not know, so the flag is set for the releases that it was tried on and no other.
"""

import os
import sys
import warnings
from collections.abc import Callable
from functools import cache

from jaxlib import version as jaxlib_version

FLAG = "--xla_cpu_experimental_ynn_fusion_type="
NEEDING_FLAG = ("0.10.2", "0.11.2", "0.12.0", "0.12.0.1")  # wrong without it, right with it, all four tried
ROWS = 4097  # wrong from about a thousand rows on

_WAITING: list[Callable[[], None]] = []
REMEDY = (
    f"set XLA_FLAGS={FLAG} in the environment, with nothing after the equals sign, before Python starts, or install "
    "jax 0.10.1"
)


class WrongSumsError(RuntimeError):
    """jax sums wrongly in this process."""


def lacks_flag() -> bool:
    """Whether this release of jaxlib needs the flag and `XLA_FLAGS` does not hold it."""
    name = FLAG.removesuffix("=")
    given = any(flag.split("=")[0] == name for flag in os.environ.get("XLA_FLAGS", "").split())
    return jaxlib_version.__version__ in NEEDING_FLAG and not given


def set_flag() -> None:
    """Add the flag to `XLA_FLAGS` where this release needs it and XLA has not read its flags yet.

    For programs, not for libraries: the variable holds for all of jax in this process, and for its children.
    """
    if lacks_flag() and not _backend_started():
        os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {FLAG}".strip()


@cache
def check_sums() -> None:
    """Sum small whole numbers on the default device, once a process.

    Raises:
        WrongSumsError: If the sum is wrong, with what to do about it in one sentence.
    """
    import jax
    import numpy as np

    matrix = np.ones((4, 4), np.float32)  # a constant of the program: as an argument it is summed rightly

    def total(rows: jax.Array) -> jax.Array:
        return jax.vmap(lambda row: matrix @ row)(rows).sum()

    found = float(jax.jit(total)(np.ones((ROWS, 4), np.float32)))
    right = 16.0 * ROWS  # below 2^24: exact in float32 in any order
    if found != right:
        raise WrongSumsError(f"jax {jax.__version__} sums to {found:g} what is {right:g}: {REMEDY}")


def ensure_right_sums() -> None:
    """Set the flag where it is needed and still possible, then check a sum: call it before jax computes anything.

    Example:
        >>> import cablejax
        >>> cablejax.ensure_right_sums()

    Raises:
        WrongSumsError: If jax sums wrongly all the same, because it computed before, or in a release not known here.
    """
    set_flag()
    check_sums()


def once_used(do: Callable[[], None]) -> None:
    """Do something when the first part that computes with jax is imported; now if one has been."""
    if "cablejax.types" in sys.modules:
        do()
    elif do not in _WAITING:
        _WAITING.append(do)


def warn_where_wrong() -> None:
    """Warn where this release needs the flag and lacks it, for whoever uses the package as a library.

    `cablejax.types` asks, which every part that computes with jax imports; what waited for that is done first.
    """
    while _WAITING:
        _WAITING.pop()()
    if lacks_flag():
        warnings.warn(
            f"jax {jaxlib_version.__version__} sums wrongly on the CPU as it is set up: call "
            f"cablejax.ensure_right_sums() before the first import of a part of cablejax, or {REMEDY}",
            stacklevel=3,
        )


def _backend_started() -> bool:
    bridge = sys.modules.get("jax._src.xla_bridge")
    return bridge is not None and bridge.backends_are_initialized()
