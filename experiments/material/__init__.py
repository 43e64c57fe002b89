"""What experiments are made of: scans and their cleaning, clouds and the training on them, and the geometric baseline."""
