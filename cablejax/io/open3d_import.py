"""Import open3d where a system library that its wheel links to is missing."""

import ctypes
import importlib
import sys
from types import ModuleType

from cablejax.optional import require

MISSING = (
    "open3d cannot be imported ({reason}). It needs the system libraries libusb-1.0, libGL and libEGL; "
    "on Debian or Ubuntu: apt-get install libusb-1.0-0 libgl1 libegl1. Everything that does not use open3d still works."
)


def import_open3d() -> ModuleType:
    """Import open3d, with libusb from the package `libusb-package` where the system has none.

    Returns:
        The module.

    Raises:
        ImportError: If it is not installed, naming the extra that brings it, or cannot be imported, naming the system
            packages that it needs.
    """
    require("open3d", why="a comparison with Open3D")
    try:
        return importlib.import_module("open3d")
    except ImportError as error:
        # A failed import must be forgotten before the next try, or its half-made submodules stay.
        first = error
    _forget("open3d")
    try:
        import libusb_package

        ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)
        return importlib.import_module("open3d")
    except (ImportError, OSError) as error:
        raise ImportError(MISSING.format(reason=first)) from error


def _forget(name: str) -> None:
    """Remove a module and its submodules from the table of imported ones."""
    for module in [module for module in sys.modules if module == name or module.startswith(f"{name}.")]:
        del sys.modules[module]
