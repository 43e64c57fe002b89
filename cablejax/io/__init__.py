"""cablejax.io"""
