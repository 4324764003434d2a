"""An OpenSim model of the same person beside ours."""

from gaitcal.compare.comparison import ComparisonRow, compare
from gaitcal.export.osim_reader import read_osim

__all__ = ["compare", "ComparisonRow", "read_osim"]
