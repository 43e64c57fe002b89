"""cablejax: cable point clouds in JAX, from a laser scan to a diameter with its uncertainty.

Import the part you need: `cablejax.ops` (jit kernels), `cablejax.io` (scanner files), `cablejax.simulate`,
`cablejax.registration`, `cablejax.measure`, `cablejax.nets`, `cablejax.train`. Importing this package imports nothing
else, jax neither, and changes no setting of jax or of the process.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cablejax.jax_sums import ensure_right_sums
    from cablejax.programs import make_room
    from cablejax.types import PointCloud, Status, StatusError, capacity_for, describe, raise_on

__version__ = "0.1.0"

__all__ = [
    "PointCloud",
    "Status",
    "StatusError",
    "capacity_for",
    "describe",
    "ensure_right_sums",
    "make_room",
    "raise_on",
]

_WHERE = dict.fromkeys(__all__, "cablejax.types") | {
    "ensure_right_sums": "cablejax.jax_sums",
    "make_room": "cablejax.programs",
}


def __getattr__(name: str) -> Any:
    """Import a name of `__all__` when it is first used (PEP 562)."""
    if name not in _WHERE:
        raise AttributeError(f"module 'cablejax' has no attribute {name!r}")
    return getattr(importlib.import_module(_WHERE[name]), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
