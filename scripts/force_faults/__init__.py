"""Parts of `check_force_faults.py`: people, faults, cases and their tables."""
