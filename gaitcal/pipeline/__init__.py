"""From files to a written result: a study, a folder, or further trials of a calibrated person."""
