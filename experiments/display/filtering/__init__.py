"""Filtering and the diameter of the filtered scan."""
