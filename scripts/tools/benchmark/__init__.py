"""What gaitcal takes, section by section: `python -m scripts.tools.benchmark`."""
