"""How much of what the markers say is independent: the noise that priors and earlier trials are weighed against.

Skin movement repeats itself from frame to frame: a thousand frames hold far fewer than a thousand independent samples,
and S^-1, the inverse of the reduced Gauss-Newton matrix, times the variance of the residuals is far too small a
covariance. The noise nu is what makes nu^2 S^-1 as large as the covariance C that the marker coordinates themselves
show (cluster-robust, `influence.py`), every parameter in units of the deviation its prior allows: those that the
markers see least, on which alone a prior acts, count most. Of the G independent scores of the marker coordinates the n
fitted parameters take up n:

    nu^2 = G / (G - n) * (sum_k C_kk / sigma_k^2) / (sum_k (S^-1)_kk / sigma_k^2).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gaitcal.calibration.influence import MarkerEvidence

Array = NDArray[np.float64]

LEAST_NOISE = 1e-6
"""m, below anything that is measured: markers without noise leave nothing to weigh."""


def independent_noise(hessian: Array, evidence: MarkerEvidence, kept: Array, deviation: Array) -> float:
    """Marker noise (m) of a fit, as if every unit of S were an independent sample.

    Parameters
    ----------
    hessian : (np, np) m^2 per units of p, S of all parameters of the fit.
    evidence : what its markers say by themselves.
    kept : (n,) indices of the parameters that they determine; at least one.
    deviation : (n,) m, rad: standard deviations of the priors.
    """
    own = np.ix_(kept, kept)
    scores = (hessian @ evidence.covariance @ hessian)[own]
    inverse = np.linalg.inv(hessian[own])
    seen = np.diag(inverse @ scores @ inverse) / deviation**2
    plain = np.diag(inverse) / deviation**2
    degrees = evidence.coordinates / max(evidence.coordinates - len(kept), 1)
    return max(float(np.sqrt(degrees * seen.sum() / plain.sum())), LEAST_NOISE)
