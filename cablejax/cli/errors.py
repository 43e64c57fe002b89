"""How a command fails."""


class NoResultError(Exception):
    """A command has no result; the message is the one line that its user sees."""
