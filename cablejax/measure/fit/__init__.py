"""Axis and radius fitted to all points of a cable, with what scanners and their sweeps do to them."""
