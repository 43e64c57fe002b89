"""open3d is imported lazily, with libusb from a package, or refused in one sentence."""

import ctypes
import subprocess
import sys

import pytest

from cablejax.io import import_open3d, open3d_import


def test_a_failed_import_says_what_to_install(monkeypatch):
    def fail(name):
        raise ImportError("libGL.so.1: cannot open shared object file")

    monkeypatch.setattr(open3d_import.importlib, "import_module", fail)
    monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: None)
    monkeypatch.setattr(open3d_import, "_forget", lambda _: None)  # another test may have the real one loaded
    with pytest.raises(ImportError, match=r"\(libGL\.so\.1.*apt-get install libusb-1\.0-0 libgl1 libegl1"):
        import_open3d()


def test_a_second_try_after_loading_libusb(monkeypatch):
    calls = []
    libusb_package = pytest.importorskip("libusb_package")

    def import_module(name):
        calls.append(name)
        if name == "libusb_package":
            return libusb_package
        if len(calls) == 1:
            raise ImportError("libusb-1.0.so.0: cannot open shared object file")
        return sys

    loaded = []
    monkeypatch.setattr(open3d_import.importlib, "import_module", import_module)
    monkeypatch.setattr(ctypes, "CDLL", lambda path, mode: loaded.append(path))
    monkeypatch.setattr(open3d_import, "_forget", lambda _: None)
    assert import_open3d() is sys
    assert [name for name in calls if name == "open3d"] == ["open3d", "open3d"]
    assert "libusb" in loaded[0]


def test_importing_cablejax_io_is_light():
    heavy = ("open3d", "matplotlib", "tensorboardX", "laspy", "pye57", "hydra")
    code = f"import sys, cablejax.io; print([m for m in {heavy!r} if m in sys.modules])"
    assert (
        subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip() == "[]"
    )
