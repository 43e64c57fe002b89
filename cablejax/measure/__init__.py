"""cablejax.measure"""
