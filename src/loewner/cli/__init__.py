"""The command line: a file for each command, put together by `main`."""

from loewner.cli.main import main

__all__ = ["main"]
