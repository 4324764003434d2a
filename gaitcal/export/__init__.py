"""Taking results to other programs: OpenSim, MuJoCo, URDF readers.

Everything written here describes the same mechanical system, with the same 27 coordinates (names, signs, zeros).
"""

from gaitcal.export.mjcf import write_mjcf
from gaitcal.export.motion_files import write_external_loads, write_mot, write_sto_moments
from gaitcal.export.osim import write_osim
from gaitcal.export.urdf import write_urdf
from gaitcal.export.xml_text import original_name, safe_name

__all__ = [
    "write_osim",
    "write_urdf",
    "write_mjcf",
    "write_mot",
    "write_sto_moments",
    "write_external_loads",
    "safe_name",
    "original_name",
]
