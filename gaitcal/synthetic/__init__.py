"""Synthetic subjects with known parameters: motions, recordings and true values."""
