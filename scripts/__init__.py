"""What stands beside the package: examples, tools of its makers, and what validates it. Run from a
checkout.
"""

import os

for _name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ[_name] = "1"  # read when NumPy is loaded, which happens later; workers inherit it
