"""The arrays of this project, by what they hold. Shapes and units stand beside each field and in each docstring."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""Real numbers."""
BoolArray = NDArray[np.bool_]
"""Yes or no."""
IntArray = NDArray[np.intp]
"""Numbers of frames, markers, ...: indices."""
