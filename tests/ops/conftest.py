"""Open3D as a peer, which a bare machine lets in only with libusb at hand."""

import ctypes

import numpy as np
import pytest


@pytest.fixture(scope="session")
def open3d_cloud():
    libusb_package = pytest.importorskip("libusb_package")
    ctypes.CDLL(str(libusb_package.get_library_path()), mode=ctypes.RTLD_GLOBAL)
    open3d = pytest.importorskip("open3d")
    return lambda xyz: open3d.geometry.PointCloud(open3d.utility.Vector3dVector(xyz.astype(np.float64)))
