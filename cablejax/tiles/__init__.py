"""Point files larger than memory, cleaned tile by tile."""

from cablejax.tiles.denoise import Settings, TiledResult, denoise_file

__all__ = ["Settings", "TiledResult", "denoise_file"]
