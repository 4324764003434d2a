"""Marker tracking: splines, residuals, banded Gauss-Newton."""
