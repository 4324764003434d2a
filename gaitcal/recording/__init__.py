"""Recordings of motion and ground reaction: reading, writing, turning, filtering.

A file in any of the formats becomes a `Recording`: metres, seconds, newtons, newton metres; y up, right-handed.
"""

from gaitcal.recording.axes import make_y_up, net_progression, turn_to_progression
from gaitcal.recording.c3d.writer import write_c3d
from gaitcal.recording.convert import convert
from gaitcal.recording.csv import write_forces_csv, write_markers_csv
from gaitcal.recording.filters import filter_plate, low_pass, resample_wrench
from gaitcal.recording.force_tables import Forces
from gaitcal.recording.mot import StorageTable, read_table, write_forces_mot
from gaitcal.recording.read import read_forces, read_recording
from gaitcal.recording.recording import ForcePlate, MarkerGaps, Recording, marker_gaps, seen_mask
from gaitcal.recording.still import StillWindow, still_window
from gaitcal.recording.trc import write_trc

__all__ = [
    "Recording",
    "ForcePlate",
    "Forces",
    "read_recording",
    "read_forces",
    "StorageTable",
    "read_table",
    "turn_to_progression",
    "net_progression",
    "make_y_up",
    "StillWindow",
    "still_window",
    "MarkerGaps",
    "marker_gaps",
    "seen_mask",
    "low_pass",
    "filter_plate",
    "resample_wrench",
    "write_markers_csv",
    "write_forces_csv",
    "write_trc",
    "write_forces_mot",
    "write_c3d",
    "convert",
]
