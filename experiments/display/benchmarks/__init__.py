"""Benchmarks: speed beside other libraries, scaling, denoising, files."""
