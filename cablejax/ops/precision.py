"""What kernels over coordinates compute in: float32, and nothing else without a word."""

import jax.numpy as jnp
from jaxtyping import Array


def require_float32(**arrays: Array | None) -> None:
    """Refuse arrays that are not float32.

    float64 (under `jax_enable_x64`) would be computed in another precision than tested, float16 and bfloat16 lose
    neighbours, and whole numbers have no gradient: the caller converts, and shifts large coordinates first.

    Args:
        arrays: By the name that the caller knows them by, `__` for a dot; None is passed over.

    Raises:
        ValueError: Naming the first that is not, and its dtype.

    Example:
        >>> require_float32(cloud__xyz=jnp.zeros((2, 3), jnp.float16))
        Traceback (most recent call last):
        ValueError: cloud.xyz: expected float32, got float16; convert it with .astype(jnp.float32)
    """
    for name, array in arrays.items():
        if array is not None and array.dtype != jnp.float32:
            name = name.replace("__", ".")
            raise ValueError(f"{name}: expected float32, got {array.dtype}; convert it with .astype(jnp.float32)")
