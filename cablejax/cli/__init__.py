"""The `cablejax` command. Importing this is quick: what a command needs is imported when it runs."""

from cablejax.cli.main import main

__all__ = ["main"]
