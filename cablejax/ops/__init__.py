"""cablejax.ops"""
