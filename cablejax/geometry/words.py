"""Places in words, for tables and pages alike."""


def where(from_mm: float, to_mm: float) -> str:
    """A range in whole millimetres, in words; a step is at one place.

    Example:
        >>> where(23.1, 23.1), where(-3.0, 22.6)
        ('23', '-3 to 23')
    """
    ends = [f"{from_mm:.0f}", f"{to_mm:.0f}"]
    return ends[0] if ends[0] == ends[1] else " to ".join(ends)
