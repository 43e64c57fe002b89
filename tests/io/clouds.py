"""Small clouds and files that the tests of readers and writers share."""

import numpy as np

XYZ = np.array([[1.5, -2.25, 3.125], [0.1, 0.2, 0.3], [-1e3, 1e-3, 12345.678901]])
COLOR = np.array([[255, 0, 7], [1, 2, 3], [128, 64, 32]], np.uint8)
INTENSITY = np.array([0.0, 12.0, 65535.0], np.float32)

PTX_SCAN = """2
2
0 0 0
1 0 0
0 1 0
0 0 1
0 1 0 0
-1 0 0 0
0 0 1 0
10 20 30 1
"""
PTX_ROWS = "1 2 3 0.5 255 0 7\n0 0 0 0.5 0 0 0\n4 5 6 0.25 1 2 3\n0 0 0 0 0 0 0\n"


def lzf_compress(data: bytes) -> bytes:
    """LZF by definition: literal runs of up to 32 bytes, and runs of one byte as overlapping references."""
    out, at = bytearray(), 0
    while at < len(data):
        run = 1
        while at + run < len(data) and data[at + run] == data[at] and run < 265:
            run += 1
        if run >= 4:  # one literal, then a reference one byte back
            length = run - 1 - 2
            out += bytes([0, data[at]])
            out += bytes([length << 5, 0]) if length < 7 else bytes([7 << 5, length - 7, 0])
            at += run
        else:
            out += bytes([0, data[at]])
            at += 1
    return bytes(out)
