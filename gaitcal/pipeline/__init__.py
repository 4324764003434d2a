"""From files to a written result: a study, a folder of recordings, or further trials of a
calibrated person.
"""
