"""Registration: the rigid motion between scans, and which parts of it the scans leave open."""

from cablejax.geometry.normals import surface_normals
from cablejax.geometry.voxels import voxel_means
from cablejax.registration.automatic import Alignment, register_auto
from cablejax.registration.coarse import CoarseStart, coarse_start
from cablejax.registration.icp import icp
from cablejax.registration.pyramid import register
from cablejax.registration.result import RegistrationResult
from cablejax.registration.stations import Stations, register_stations

__all__ = [
    "Alignment",
    "CoarseStart",
    "RegistrationResult",
    "Stations",
    "coarse_start",
    "icp",
    "register",
    "register_auto",
    "register_stations",
    "surface_normals",
    "voxel_means",
]
