"""From a study to a calibrated person: joint fit, inertial fit, torques, error bars, verdict; the
result objects.
"""
