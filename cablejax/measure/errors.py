"""The one error of a measurement: a sentence for the person who holds the scanner."""


class MeasureError(ValueError):
    """The scan does not give a diameter, and the message says why and what would help."""
