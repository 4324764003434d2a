"""Tools of those who make gaitcal: `python -m scripts.tools.NAME` from a checkout."""
