"""The main job: from a folder or a study to a calibrated person."""
