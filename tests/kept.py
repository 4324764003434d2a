"""What several test files need and nobody changes: made once a run, by whichever process asks
first.
"""

from __future__ import annotations

import os
import pickle
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import pytest

from gaitcal.io.result_folder import lock_result

if TYPE_CHECKING:
    from gaitcal import Calibration

T = TypeVar("T")
LONGEST_S = 600.0
"""A process that is waited for may have half a core."""


def run_folder(factory: pytest.TempPathFactory) -> Path:
    """The one temporary folder of all processes of this run."""
    base = factory.getbasetemp()
    return (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "kept"


def kept_folder(folder: Path, make: Callable[[Path], object]) -> Path:
    """`folder`, which `make` writes unless this run has it already. Tests that change anything
    change a copy.
    """
    done = folder.with_name(f"{folder.name}.made")
    folder.parent.mkdir(parents=True, exist_ok=True)
    with lock_result(folder, "kept", wait_s=LONGEST_S):
        if not done.exists():
            shutil.rmtree(folder, ignore_errors=True)
            make(folder)
            done.touch()
    return folder


def write_person(out: Path, *, whole: bool = False, **options: Any) -> Path:
    """`gaitcal.synthesize`; unless the person is to be whole, isolated trials last 2 s, not 6 s."""
    from gaitcal.synthetic import synthetic_motion
    from gaitcal.synthetic.subject import synthesize

    with pytest.MonkeyPatch.context() as patch:
        if not whole:
            patch.setattr(synthetic_motion, "ISOLATED_FRAMES", round(2 * synthetic_motion.RATE))
        return synthesize(out, **options)


def kept_person(
    kept: Path, *, seed: int = 0, noise: bool = False, perturb: bool = False, whole: bool = False
) -> Path:
    """The study file of `write_person`, in a folder that nobody changes."""
    chosen = {"seed": seed, "noise": noise, "perturb": perturb, "whole": whole}
    name = "".join(f"--{option}{value:d}" for option, value in chosen.items() if value)
    return (
        kept_folder(kept / f"person{name}", lambda out: write_person(out, **chosen)) / "study.toml"
    )


def copied_person(kept: Path, out: Path | str, **options: Any) -> Path:
    """In place of `write_person`: the same files in `out`."""
    return (
        Path(shutil.copytree(kept_person(kept, **options).parent, out, dirs_exist_ok=True))
        / "study.toml"
    )


def kept_calibration(kept: Path) -> Calibration:
    """Of the person of seed 3 with noise, whose joints and masses are not the nominal ones; a copy
    of one's own.
    """
    from gaitcal import Study, calibrate

    study = kept_person(kept, seed=3, noise=True, perturb=True, whole=True)
    return kept_object(
        kept / "calibration--seed3--noise--perturb", lambda: calibrate(Study.load(study))
    )


def kept_real(kept: Path, name: str, data: Path) -> Calibration:
    """Of one of the real people (`tests/real_studies.py`); a copy of one's own."""
    from gaitcal import Study, calibrate
    from tests.real_studies import write_study

    def make() -> Calibration:
        folder = kept / "real" / name
        folder.mkdir(parents=True, exist_ok=True)
        return calibrate(Study.load(write_study(name, data.resolve(), folder)))

    return kept_object(kept / f"calibration--{name}", make)


def kept_result(kept: Path) -> Path:
    """A folder with the `study` that `write_synthetic_study` writes, and its `result`; nobody
    changes it.
    """
    from gaitcal import Study, calibrate, write_results
    from tests.synthetic_studies import write_synthetic_study

    def make(folder: Path) -> None:
        calibration = calibrate(Study.load(write_synthetic_study(folder / "study")))
        write_results(calibration, folder / "result")
        (kept / "synthetic.pickle").write_bytes(pickle.dumps(calibration))

    return kept_folder(kept / "synthetic", make)


def kept_synthetic(kept: Path) -> Calibration:
    """The calibration of `kept_result`; a copy of one's own."""
    kept_result(kept)
    found: Calibration = pickle.loads((kept / "synthetic.pickle").read_bytes())
    return found


def kept_object(folder: Path, make: Callable[[], T]) -> T:
    """What `make` returns, in a copy of one's own; `folder` holds it for this run."""

    def write(place: Path) -> None:
        place.mkdir()
        (place / "object.pickle").write_bytes(pickle.dumps(make()))

    found: T = pickle.loads((kept_folder(folder, write) / "object.pickle").read_bytes())
    return found
