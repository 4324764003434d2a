"""`gaitcal synthesize` and `calibrate STUDY.toml`, which compute each person and each calibration
once a run.

Several pages begin with the same person, and calibrate it. A result of a folder without a study
file is computed each time: the study in it leads to its recordings.
"""

import hashlib
import os
import shutil
import subprocess
import sys
from pathlib import Path

from tests.kept import copied_person, kept_folder


def without_out(words: list[str]) -> tuple[list[str], str]:
    """Words but `--out OUT`, and OUT."""
    at = words.index("--out")
    return words[:at] + words[at + 2 :], words[at + 1]


def synthesize(kept: Path, words: list[str]) -> None:
    options, out = without_out(words)
    seed = int(options[options.index("--seed") + 1]) if "--seed" in options else 0
    seed *= seed > 1  # the second person of one page is the first of the others
    copied_person(kept, out, seed=seed, noise="--noise" in options, perturb="--perturb" in options)


def calibrate(kept: Path, words: list[str]) -> None:
    options, out = without_out(words)
    (study,) = (Path(word) for word in options if word.endswith(".toml"))
    key = hashlib.sha256(" ".join(options).encode())
    for file in sorted(study.parent.rglob("*")):
        key.update(file.name.encode() + (file.read_bytes() if file.is_file() else b""))

    def make(folder: Path) -> None:
        command = [
            sys.executable,
            "-m",
            "gaitcal.cli",
            "calibrate",
            *options,
            "--out",
            str(folder / "result"),
        ]
        folder.mkdir()
        (folder / "said").write_bytes(
            subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout
        )

    made = kept_folder(kept / "calibrations" / key.hexdigest(), make)
    shutil.copytree(made / "result", out)
    sys.stdout.write((made / "said").read_text(encoding="utf-8").replace(str(made / "result"), out))


if __name__ == "__main__":
    {"synthesize": synthesize, "calibrate": calibrate}[sys.argv[1]](
        Path(os.environ["GAITCAL_TESTS_KEPT"]), sys.argv[2:]
    )
