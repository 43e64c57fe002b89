"""The errors of a measurement: a sentence for the person who holds the scanner."""


class MeasureError(ValueError):
    """The scan does not give a diameter, and the message says why and what would help."""


class NoCableError(MeasureError):
    """There is nothing round at the place that was looked at."""
