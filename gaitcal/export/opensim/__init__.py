"""OpenSim models: ours written; those of users read, compared and given calibrated joints."""
