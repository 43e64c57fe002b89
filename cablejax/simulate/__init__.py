"""cablejax.simulate"""
