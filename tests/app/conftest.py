"""The page shows what was measured once."""

from tests.measured_once import _measured_once

__all__ = ["_measured_once"]
