"""`[truth]` of a study file: where the known truth of a made-up person lies, and how it is told."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Literal

from pydantic import Field

from gaitcal.io.toml import Table, require_file


class TruthTable(Table):
    """`[truth]`: only where somebody knows it, as the program that made the recordings does."""

    parameters: Path = Field(strict=False, description="CSV of the true parameters: name,unit,value")
    folder: Path | None = Field(
        default=None, strict=False, description="folder of TRIAL_motion.csv and TRIAL_moments.csv, the true curves"
    )
    landmarks: Path = Field(
        strict=False,
        description="CSV of the static trial's landmarks, which make the truth's segment frames: name,x,y,z, m",
    )
    markers: str = Field(description="name of the marker set whose landmarks make the truth's segment frames")
    hip_centre: Literal["bell", "orthotrak", "harrington", "given"] = Field(
        description="the nominal hip centre whose segment frames the truth is told in; that of the calibration"
    )
    ankle_zero: Literal["auto", "sole", "markers", "file"] = Field(
        description="what the true ankle angles are counted from; that of the calibration"
    )

    def found(self, at: Callable[[Path], Path], source: Path) -> TruthTable:
        """The same with paths that `at` makes absolute, and a file there."""
        files = {
            field: require_file(at(getattr(self, field)), source=source, field=f"truth.{field}")
            for field in ("parameters", "landmarks")
        }
        return self.model_copy(update=files | ({"folder": at(self.folder)} if self.folder else {}))
