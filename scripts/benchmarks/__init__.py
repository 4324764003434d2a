"""What `scripts/benchmark.py` measures, section by section."""
