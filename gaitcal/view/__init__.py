"""See it: a calibrated person, markers and forces in the browser, from one file that opens offline."""

from gaitcal.view.page import view_html, write_view
from gaitcal.view.playback import left_out
from gaitcal.view.scene import Scene, TrialScene, person_scene, scene_of, trial_scene
from gaitcal.view.scene_file import load_scene, save_scene
from gaitcal.view.server import ViewServer, serve

__all__ = [
    "Scene",
    "TrialScene",
    "scene_of",
    "person_scene",
    "trial_scene",
    "save_scene",
    "load_scene",
    "write_view",
    "view_html",
    "left_out",
    "serve",
    "ViewServer",
]
