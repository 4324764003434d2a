"""The Monte Carlo study: what uncertain joint axes, masses and markers do to joint torques."""
