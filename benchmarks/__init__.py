"""Timings against other libraries, one script a claim. Importing this sets the flag without which current jax sums wrongly."""

from cablejax.jax_sums import set_flag

set_flag()
