"""Taking results to other programs: OpenSim, MuJoCo, URDF readers.

Every `write_...` describes the same mechanical system, with the same 27 coordinates (names, signs,
zeros); `joint_transfer` puts its joints into an OpenSim model of the user's own.
"""
