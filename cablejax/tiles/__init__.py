"""Point files larger than memory, cleaned tile by tile."""

from cablejax.tiles.denoise import Settings, TiledResult, TileError, denoise_file

__all__ = ["Settings", "TileError", "TiledResult", "denoise_file"]
