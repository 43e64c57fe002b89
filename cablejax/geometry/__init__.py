"""Geometry of clouds on the host, in NumPy float64, for what measures and registers.

The jit kernels of `cablejax.ops` work in float32 with shapes known beforehand. Here the number of voxels is the scan's own,
coordinates keep their digits, and nothing is compiled.
"""
