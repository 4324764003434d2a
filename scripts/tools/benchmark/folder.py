"""A folder that lasts as long as the benchmark."""

from __future__ import annotations

import atexit
import shutil
import tempfile
from pathlib import Path


def temporary_folder() -> Path:
    """A new folder, removed when Python ends."""
    folder = Path(tempfile.mkdtemp(prefix="gaitcal-benchmark-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder
