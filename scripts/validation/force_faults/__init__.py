"""Faults of force plates: are they named, with their size, and clean recordings left in peace?"""
