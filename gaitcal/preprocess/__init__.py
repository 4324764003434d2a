"""Prepare the trials of a study, once: swapped labels, outliers, gaps, knocked clusters, static
trial.
"""
