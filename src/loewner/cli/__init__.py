"""The command line: one file per command, combined by `main`."""

from loewner.cli.main import main

__all__ = ["main"]
