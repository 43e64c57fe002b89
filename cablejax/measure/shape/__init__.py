"""What the fitted surface looks like: ends, sections, ovality, bends, stretches and steps."""
