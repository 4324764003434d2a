"""`gaitcal synthesize`, which computes each made-up person once a run: several pages begin with the same ones."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

from tests.kept import kept_folder


def main() -> None:
    words = [word for word in sys.argv[2:] if word != "--quiet"]
    at = words.index("--out")
    out = words[at + 1]
    options = words[:at] + words[at + 2 :]

    def make(folder: Path) -> None:
        command = [sys.executable, "-m", "gaitcal.cli", "synthesize", "--quiet", "--out", str(folder), *options]
        subprocess.run(command, check=True)

    name = "".join(["person", *options])
    shutil.copytree(kept_folder(Path(os.environ["GAITCAL_TESTS_KEPT"]) / name, make), out)


if __name__ == "__main__":
    main()
