"""Reproduction of the study of 2007: its tables and claims, with our figures."""
