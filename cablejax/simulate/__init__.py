"""Simulated cable scans with exact truth: nominal sizes, shapes, scanners, noise, and the dataset made from them."""

from cablejax.simulate.catalogue import Cable, catalogue, nominal_probabilities
from cablejax.simulate.dataset import DatasetConfig, Split, make_split, sample_clouds
from cablejax.simulate.noise import add_noise, noise_mm
from cablejax.simulate.presets import PRESETS, Scanner, scanner
from cablejax.simulate.scanner import Part, Scan, simulate_scan
from cablejax.simulate.shapes import SurfacePoint, Tube, locate, make_tube, signed_distance

__all__ = [
    "PRESETS",
    "Cable",
    "DatasetConfig",
    "Part",
    "Scan",
    "Scanner",
    "Split",
    "SurfacePoint",
    "Tube",
    "add_noise",
    "catalogue",
    "locate",
    "make_split",
    "make_tube",
    "noise_mm",
    "nominal_probabilities",
    "sample_clouds",
    "scanner",
    "signed_distance",
    "simulate_scan",
]
