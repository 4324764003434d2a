"""Hip and lumbar joint centres from the pelvis markers alone, as fractions of the distance between the two ASIS.

Bell, Pedersen and Brand (J Biomech 23:617-621, 1990): 19.3 % behind, 30.4 % below, 35.9 % beside the middle of the
ASIS, as Reinbolt et al. 2007 quote them; OrthoTrak: 22, 34, 32 %, deduced from the differences that the latter print in
Table II.
"""

from __future__ import annotations

from enum import Enum

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


class HipCentre(Enum):
    """Regression for the nominal hip centre."""

    BELL = "bell"
    ORTHOTRAK = "orthotrak"


_FRACTIONS = {HipCentre.BELL: (-0.193, -0.304, 0.359), HipCentre.ORTHOTRAK: (-0.22, -0.34, 0.32)}
_NOMINAL_ASIS = 0.245
"""m, of the nominal subject."""
_NOMINAL_LUMBAR = (-0.095, 0.077, 0.0)
"""m in its pelvis frame: about the third lumbar vertebra, as in Anderson and Pandy 1999."""


def hip_centre(rule: HipCentre, asis_distance: float, side: str) -> Array:
    """(3,) m, hip centre in the pelvis frame (origin midway between the ASIS)."""
    ant, sup, lat = _FRACTIONS[rule]
    return asis_distance * np.array([ant, sup, lat if side == "r" else -lat])


def lumbar_joint(asis_distance: float) -> Array:
    """(3,) m, lumbar joint in the pelvis frame: the nominal subject's, scaled alike in all directions by the ASIS."""
    return np.array(_NOMINAL_LUMBAR) * (asis_distance / _NOMINAL_ASIS)
