"""Simulated cable scans with exact truth: nominal sizes, shapes, scanners, noise, and the dataset made from them."""

from cablejax.simulate.accessories import Revolved, with_clamp, with_joint, with_stress_cone, with_termination
from cablejax.simulate.centrelines import ArcChain, Catenary
from cablejax.simulate.clutter import Box, Neighbour, Plane, Scene, bare, neighbours, support, tray, trefoil, wall
from cablejax.simulate.dataset import DatasetConfig, Split, make_split, sample_clouds
from cablejax.simulate.noise import add_noise, noise_mm
from cablejax.simulate.nominal import Cable, catalogue, nominal_probabilities
from cablejax.simulate.part_clouds import PARTS, PartsConfig, PartSplit, make_part_split
from cablejax.simulate.presets import PRESETS, Scanner, scanner
from cablejax.simulate.profiles import Profile, ProfiledTube, make_profiled
from cablejax.simulate.scan import Scan, scan_scene, simulate_scan, station_points
from cablejax.simulate.scenes import SCENES, make_scene
from cablejax.simulate.shapes import SHAPES, Tube, make_tube
from cablejax.simulate.sheath import FINISHES, Finish, finish, sheath_finish
from cablejax.simulate.stored import load_arrays, load_split, save_split
from cablejax.simulate.surface import Part, SurfacePoint, locate, signed_distance
from cablejax.simulate.user_catalogue import read_catalogue

__all__ = [
    "FINISHES",
    "PARTS",
    "PRESETS",
    "SCENES",
    "SHAPES",
    "ArcChain",
    "Box",
    "Cable",
    "Catenary",
    "DatasetConfig",
    "Finish",
    "Neighbour",
    "Part",
    "PartSplit",
    "PartsConfig",
    "Plane",
    "Profile",
    "ProfiledTube",
    "Revolved",
    "Scan",
    "Scanner",
    "Scene",
    "Split",
    "SurfacePoint",
    "Tube",
    "add_noise",
    "bare",
    "catalogue",
    "finish",
    "load_arrays",
    "load_split",
    "locate",
    "make_part_split",
    "make_profiled",
    "make_scene",
    "make_split",
    "make_tube",
    "neighbours",
    "noise_mm",
    "nominal_probabilities",
    "read_catalogue",
    "sample_clouds",
    "save_split",
    "scan_scene",
    "scanner",
    "sheath_finish",
    "signed_distance",
    "simulate_scan",
    "station_points",
    "support",
    "tray",
    "trefoil",
    "wall",
    "with_clamp",
    "with_joint",
    "with_stress_cone",
    "with_termination",
]
