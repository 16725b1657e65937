"""The command line: each command has a file of its own, and `main` combines them."""

from loewner.cli.main import main

__all__ = ["main"]
