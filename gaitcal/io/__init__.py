"""Read recordings into arrays in SI units; write recordings, results and package data."""
