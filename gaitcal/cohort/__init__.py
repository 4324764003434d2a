"""Many people, many sessions: one calibration each, side by side, and the tables of all of them."""
