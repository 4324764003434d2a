"""The parts of `check_attacks.py`."""
