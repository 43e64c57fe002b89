"""cablejax.nets"""
