"""Calibration against bones that pins or fluoroscopy tracked under the skin markers."""
