"""The command line: options and messages only. `main` is the entry point of `gaitcal`."""

from gaitcal.cli.application import main

__all__ = ["main"]
