"""Parts of `check_folders.py`: what is done to result folders, and what must be true of them afterwards."""
