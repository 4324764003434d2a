"""What people open: body in motion, curves and tables in one self-contained file that needs no network."""

from gaitcal.page.bone_files import BoneMeshes, bones_of_folder, installed_bones
from gaitcal.page.scene import MotionScene, Scene, person_scene, scene_of, trial_scene
from gaitcal.page.scene_file import left_out, load_scene, save_scene
from gaitcal.page.view import Shown, page_html, sentences, view_html, write_view

__all__ = [
    "Shown",
    "page_html",
    "sentences",
    "Scene",
    "MotionScene",
    "scene_of",
    "person_scene",
    "trial_scene",
    "save_scene",
    "load_scene",
    "write_view",
    "view_html",
    "left_out",
    "BoneMeshes",
    "installed_bones",
    "bones_of_folder",
]
