"""What is refused or odd is measured once where it is measured at all."""

from tests.measured_once import _measured_once

__all__ = ["_measured_once"]
