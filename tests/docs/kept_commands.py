"""Commands of the pages, with people and calibrations that are computed once a run.

Several pages begin with the same person, and calibrate it. A result of a folder without a study
file is computed each time: the study in it leads to its recordings.
"""

import hashlib
import shutil
from collections.abc import Sequence
from pathlib import Path

from tests.commands import Done, gaitcal
from tests.docs.local_example import local_examples
from tests.kept import copied_person, kept_folder


def run_command(words: Sequence[str], kept: Path) -> Done:
    """Run `gaitcal`: examples are the recordings that are here, studies have fewer draws."""
    match words:
        case ["example", *_]:
            with local_examples():
                return gaitcal(*words)
        case ["synthesize", *options]:
            return synthesize(kept, options)
        case ["calibrate", *options] if any(word.endswith(".toml") for word in options):
            return calibrate(kept, options)
        case ["montecarlo", *options]:
            at = options.index("--draws") + 1
            return gaitcal("montecarlo", *options[:at], 2, *options[at + 1 :])
    return gaitcal(*words)


def without_out(words: list[str]) -> tuple[list[str], str]:
    """Words but `--out OUT`, and OUT."""
    at = words.index("--out")
    return words[:at] + words[at + 2 :], words[at + 1]


def synthesize(kept: Path, words: list[str]) -> Done:
    options, out = without_out(words)
    seed = int(options[options.index("--seed") + 1]) if "--seed" in options else 0
    seed *= seed > 1  # the second person of one page is the first of the others
    copied_person(kept, out, seed=seed, noise="--noise" in options, perturb="--perturb" in options)
    return Done(0, "", "")


def calibrate(kept: Path, words: list[str]) -> Done:
    options, out = without_out(words)
    (study,) = (Path(word) for word in options if word.endswith(".toml"))
    key = hashlib.sha256(" ".join(options).encode())
    for file in sorted(study.parent.rglob("*")):
        key.update(file.name.encode() + (file.read_bytes() if file.is_file() else b""))

    def make(folder: Path) -> None:
        folder.mkdir()
        done = gaitcal("calibrate", *options, "--out", folder / "result")
        assert done.returncode == 0, done
        (folder / "said").write_text(done.stdout, encoding="utf-8")

    made = kept_folder(kept / "calibrations" / key.hexdigest(), make)
    shutil.copytree(made / "result", out)
    said = (made / "said").read_text(encoding="utf-8")
    return Done(0, said.replace(str(made / "result"), out), "")
