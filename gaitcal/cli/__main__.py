"""`python -m gaitcal.cli` is `gaitcal`."""

from gaitcal.cli.application import main

main()
