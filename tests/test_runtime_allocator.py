"""Freed memory is kept where dask would have it given back."""

import os
import subprocess
import sys

import pytest

PROGRAM = """
import resource, sys
import numpy as np
from gaitcal.runtime import keep_freed_memory
if sys.argv[1] == "keep":
    assert keep_freed_memory()
np.ones(100_000)
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(200):
    np.ones(100_000)  # 800 kB, some 195 pages
print((resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before) // 200)
"""


def faults_per_array(how: str) -> int:
    """Pages of memory that the system hands out for each array in a process as dask starts it."""
    environment = {**os.environ, "MALLOC_TRIM_THRESHOLD_": "65536"}
    command = [sys.executable, "-c", PROGRAM, how]
    found = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return int(found.stdout)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="glibc's allocator")
def test_arrays_are_made_from_kept_memory() -> None:
    if faults_per_array("leave") < 50:
        pytest.skip("this system's allocator keeps its memory anyway")
    assert faults_per_array("keep") < 5
