"""`python -m gaitcal.cli` is `gaitcal`."""

from gaitcal.cli.program import main

main()
