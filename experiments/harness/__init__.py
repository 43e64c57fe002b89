"""What carries every experiment: the Hydra application, its schema, its runs and sweeps, and the revision that made them."""
