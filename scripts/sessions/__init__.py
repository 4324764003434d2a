"""Parts of `check_sessions.py`."""
