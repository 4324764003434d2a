"""Does gaitcal tell the truth? One harness, many members: `python -m scripts.validation --help`
from a checkout.
"""
