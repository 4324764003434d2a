"""Joint and inertial parameters from motions; how well they are known."""
