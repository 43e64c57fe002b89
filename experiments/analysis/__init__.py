"""What results say: results files read, statistics of seeds and trials, the verdict rules, and the paper's own numbers."""
