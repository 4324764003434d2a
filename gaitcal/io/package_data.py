"""What is installed: where the data folder `models/` lies, and versions of packages.

The data folder is inside the installed package, or at the top of a source checkout.
"""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
from importlib.resources import files
from pathlib import Path

from gaitcal.errors import GaitcalError


def models_path() -> Path:
    """The folder `models/`: linkage, marker sets, anthropometric tables, the nominal subject.

    A wheel carries it as `gaitcal/models`; a source checkout, also one installed in editable mode, has it beside the
    package.

    Raises
    ------
    GaitcalError
        The installation is incomplete: neither place holds the folder.
    """
    package = Path(str(files("gaitcal")))
    for folder in (package / "models", package.parent / "models"):
        if (folder / "nominal_subject.json").is_file():
            return folder
    raise GaitcalError(f"{package}: the data folder 'models' is missing; install gaitcal again")


def package_version(name: str) -> str:
    """Version of an installed package, or `unknown`."""
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"
