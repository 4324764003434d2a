"""Models and motions for other programs: OpenSim, MuJoCo, URDF readers, C3D points.

Every `write_...` describes the same mechanical system, with the same 27 coordinates (names, signs,
zeros). `opensim/joint_transfer.py` puts its joints into an OpenSim model of the user.
"""
