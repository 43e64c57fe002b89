"""cablejax.train"""
