"""Room for compiled programs: each takes hundreds of memory maps of the 65,530 that Linux grants a process.

Without room XLA aborts Python ("Unable to allocate section memory"), so old programs are let go before that.
"""

import gc
from pathlib import Path

import jax

MAPS = Path("/proc/self/maps")
LIMIT = Path("/proc/sys/vm/max_map_count")
FULL = 0.6  # share of the limit: the programs of one more shape take up to a tenth of it


def make_room(full: float = FULL) -> bool:
    """Let all compiled programs go if the process holds more than a share of the memory maps that it may.

    `PointCloud.from_xyz` does so for each capacity that it meets first; a loop over bare arrays of many sizes calls it
    itself, or pads its arrays to `capacity_for(n)` rows. What is needed again is compiled again, or loaded from jax's
    compilation cache where one is kept.

    Args:
        full: The share, above 0.

    Returns:
        Whether programs were let go. Where the system does not count maps (not Linux), never.
    """
    try:
        limit = int(LIMIT.read_text())
        with MAPS.open("rb") as lines:
            held = sum(1 for _ in lines)
    except OSError:
        return False
    if held <= full * limit:
        return False
    jax.clear_caches()
    gc.collect()
    return True
