"""Gait analysis: events, cycles, strides, joint moments in numbers."""
