"""OpenSim models: ours written, and users' own read, compared and given calibrated joints."""
