"""The command line: options, words and nothing else. `main` is what `gaitcal` starts."""

from gaitcal.cli.application import main

__all__ = ["main"]
