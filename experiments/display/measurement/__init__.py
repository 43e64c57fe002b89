"""The measured diameter: coverage, real scans, and what labels or a known scanner do for it."""
