"""Run the command line: `python -m gaitcal.cli` is the same as `gaitcal`."""

from gaitcal.cli.application import main

main()
