"""What a program that uses jax does first: `cablejax` and the experiments do, `import cablejax` does not."""

from cablejax.compiled import keep_compiled
from cablejax.jax_sums import check_sums, once_used, set_flag


def set_up_jax() -> None:
    """Right sums, and compiled programs kept. Before jax computes anything; `jax_sums.check_sums` may follow."""
    set_flag()
    keep_compiled()


def set_up_jax_when_used() -> None:
    """`set_up_jax` and `check_sums` once a part of cablejax needs jax, whose import alone takes a second or two.

    Raises:
        WrongSumsError: Then, or now where jax is in use already.
    """
    once_used(_checked)


def _checked() -> None:
    set_up_jax()
    check_sums()
