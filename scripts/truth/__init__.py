"""What `scripts/check_truth.py` measures: people whose joints are known, beside what calibration finds."""
