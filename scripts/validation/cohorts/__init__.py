"""Cohorts of made-up people: whatever is killed, the same tables; how large they may be."""
