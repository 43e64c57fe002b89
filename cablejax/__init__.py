"""cablejax: cable point clouds in JAX, from a laser scan to a diameter with its uncertainty.

Import the part you need: `cablejax.ops` (jit kernels), `cablejax.io` (scanner files), `cablejax.simulate`,
`cablejax.registration`, `cablejax.measure`, `cablejax.nets`, `cablejax.train`.
"""

from cablejax.types import PointCloud, Status, StatusError, capacity_for, describe, raise_on

__version__ = "0.1.0"

__all__ = ["PointCloud", "Status", "StatusError", "capacity_for", "describe", "raise_on"]
