"""Bare folders of recordings as laboratories keep them: `check_clinics.py`."""
