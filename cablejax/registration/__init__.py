"""Registration: the rigid motion between two scans, and which parts of it the scans leave open."""

from cablejax.registration.icp import icp
from cablejax.registration.normals import surface_normals
from cablejax.registration.pyramid import register
from cablejax.registration.result import RegistrationResult
from cablejax.registration.voxels import voxel_means

__all__ = ["RegistrationResult", "icp", "register", "surface_normals", "voxel_means"]
