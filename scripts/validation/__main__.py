"""`python -m scripts.validation`: see `harness.py`."""

import sys

from scripts.validation.harness import main

if __name__ == "__main__":
    sys.exit(main())
