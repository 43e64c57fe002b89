"""cablejax.registration"""
