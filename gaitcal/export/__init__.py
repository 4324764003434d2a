"""Taking results to other programs: OpenSim, MuJoCo, URDF readers.

Every `write_...` describes the same mechanical system, with the same 27 coordinates (names, signs, zeros); `into_osim`
puts its joints into an OpenSim model of the user's own.
"""

from gaitcal.export.joint_transfer import CalibratedOsim, into_osim
from gaitcal.export.osim import original_name, safe_name, write_osim
from gaitcal.export.other_formats import write_external_loads, write_mjcf, write_mot, write_sto_moments, write_urdf

__all__ = [
    "into_osim",
    "CalibratedOsim",
    "write_osim",
    "write_urdf",
    "write_mjcf",
    "write_mot",
    "write_sto_moments",
    "write_external_loads",
    "safe_name",
    "original_name",
]
