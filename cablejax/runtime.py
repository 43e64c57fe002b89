"""What a program that uses jax does first: `cablejax` and the experiments do, `import cablejax` does not."""

from cablejax.compiled import keep_compiled
from cablejax.jax_sums import set_flag


def set_up_jax() -> None:
    """Right sums, and compiled programs kept. Before jax computes anything; `jax_sums.check_sums` may follow."""
    set_flag()
    keep_compiled()
