"""Networks: accuracy, ablation, robustness, and where their attention goes."""
