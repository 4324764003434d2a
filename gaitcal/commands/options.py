"""Arguments and options that several commands share, with their help."""

from pathlib import Path
from typing import Annotated

import typer

Out = Annotated[Path, typer.Option("--out", help="Folder for the results; written whole or not at all.")]
Result = Annotated[Path, typer.Argument(metavar="DIR", help="Result folder of 'gaitcal calibrate'.")]
StudyPath = Annotated[
    Path,
    typer.Argument(metavar="STUDY", help="Study file, or a folder of one person's recordings, which drafts its own."),
]
Mass = Annotated[float | None, typer.Option(help="Body mass in kg, where the recordings of a folder do not say it.")]
Height = Annotated[float | None, typer.Option(help="Body height in m, the same.")]
Sex = Annotated[str | None, typer.Option(help="female or male, the same.")]
Age = Annotated[float | None, typer.Option(help="Age in years, the same; may be left out.")]
Normal = Annotated[Path | None, typer.Option(help="CSV of normal bands, drawn behind the report's angles and moments.")]

Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Print every step, and everything that was assumed.")]
