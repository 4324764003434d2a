"""Two sessions of one person, or an OpenSim model of the same person, beside ours."""
