"""What gaitcal takes, section by section, in one BLAS thread: `python -m scripts.tools.benchmark`."""

import os

for _name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ[_name] = "1"  # read when NumPy is loaded, which happens later; workers inherit it
