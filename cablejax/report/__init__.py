"""cablejax.report"""
