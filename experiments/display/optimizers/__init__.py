"""Optimizers: Figure 13, the tuned comparisons and the study."""
