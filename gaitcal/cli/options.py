"""Arguments and options of commands, with their help texts."""

from pathlib import Path
from typing import Annotated

import typer

Out = Annotated[
    Path, typer.Option("--out", help="Folder for the results; written completely or not at all.")
]
Result = Annotated[
    Path, typer.Argument(metavar="DIR", help="Result folder of 'gaitcal calibrate'.")
]
StudyPath = Annotated[
    Path,
    typer.Argument(
        metavar="STUDY",
        help="Study file, or a folder of one person's recordings, from which one is drafted.",
    ),
]
Mass = Annotated[
    float | None, typer.Option(help="Body mass in kg, if no file of the folder contains it.")
]
Height = Annotated[float | None, typer.Option(help="Body height in m, if no file contains it.")]
Sex = Annotated[str | None, typer.Option(help="female or male, if no file contains it.")]
Age = Annotated[float | None, typer.Option(help="Age in years, if no file contains it; optional.")]
Normal = Annotated[
    Path | None,
    typer.Option(
        help="CSV of normal bands, or schwartz2008. Default: bands of children, if age and speed "
        "fit."
    ),
]
Priors = Annotated[
    Path | None,
    typer.Option(
        help="priors.json of a cohort, which replaces the joint priors from the literature."
    ),
]
LearnPriors = Annotated[
    bool,
    typer.Option(
        "--learn-priors", help="Learn joint priors from all people and write priors.json."
    ),
]

ExampleName = Annotated[
    str | None, typer.Argument(metavar="[NAME]", help="Name of the example. Default: list all.")
]
ExampleOut = Annotated[
    Path | None, typer.Option("--out", help="Folder for the files. Default: NAME.")
]
Mirror = Annotated[
    str | None,
    typer.Option(
        metavar="URL",
        help="Address of a copy to use instead of GitHub: https://, http:// or file:///.",
    ),
]

Recordings = Annotated[
    Path, typer.Argument(metavar="FOLDER", help="Folder of one person's recordings.")
]
StudyOut = Annotated[
    Path | None, typer.Option("--out", help="Study file to write. Default: FOLDER/study.toml.")
]

People = Annotated[
    Path,
    typer.Argument(
        metavar="COHORT",
        help="Folder with one sub-folder of recordings for each person, or a cohort.toml.",
    ),
]
CohortOut = Annotated[
    Path,
    typer.Option(
        "--out", help="Folder for results and tables; unchanged people are not calibrated again."
    ),
]
Retry = Annotated[
    bool, typer.Option("--retry", help="Run people again who failed, even if nothing changed.")
]
Jobs = Annotated[int, typer.Option(help="Number of processes; -1: one for each core.")]
Scheduler = Annotated[
    str | None,
    typer.Option("--cluster", help="Address of a running dask scheduler, tcp://host:port."),
]

ResultOrStudy = Annotated[
    Path,
    typer.Argument(metavar="DIR", help="Result folder of 'gaitcal calibrate', or a study folder."),
]
UntilConverged = Annotated[
    bool, typer.Option("--until-converged", help="Add draws until mean and CV stay within 2 %.")
]
Expect = Annotated[
    float | None,
    typer.Option(min=0, help="Print the torque errors to expect at this marker error (RMS, mm)."),
]

HoldOut = Annotated[
    bool,
    typer.Option(
        "--hold-out", help="Also report the marker error in time blocks left out of the fit."
    ),
]
Plates = Annotated[
    str | None,
    typer.Option(help="Feet on the plates of a single TRIAL: 1=r,2=l or none. Default: detected."),
]
Forces = Annotated[
    Path | None, typer.Option(help="File of ground reactions (.mot, .sto, .csv) of a single TRIAL.")
]
Part = Annotated[
    str | None, typer.Option("--time", help="Part of a single TRIAL to use: start,end in seconds.")
]
DynamicsOut = Annotated[
    Path | None, typer.Option("--out", help="Folder for the results. Default: DIR/dynamics.")
]
TrialRole = Annotated[str, typer.Option("--role", help="gait, or motion for any other activity.")]
FilterHz = Annotated[
    str | None,
    typer.Option(
        help="Cut-off of the force filter in Hz, or none. Default: that of the calibration."
    ),
]

Seed = Annotated[int, typer.Option(min=0, help="Seed of noise and true parameters.")]
Noise = Annotated[
    bool, typer.Option("--noise", help="Add the published marker noise (up to 10 mm).")
]
Perturb = Annotated[
    bool,
    typer.Option(
        "--perturb", help="Draw the true parameters at random within the published bounds."
    ),
]
Movements = Annotated[
    list[str] | None,
    typer.Option(
        "--movement", help="Add a trial: squat, sit-to-stand, jump, run or stairs. Repeatable."
    ),
]

MODELS = "osim,urdf,mjcf"
Formats = Annotated[
    str,
    typer.Option(
        "--format",
        help="Comma-separated: osim, urdf, mjcf (model), c3d (recordings), cycles (strides).",
    ),
]
ExportFolder = Annotated[
    Path | None,
    typer.Option(
        "--out", help="Folder for the files. Default: DIR/export. With --into: the .osim file."
    ),
]
Into = Annotated[
    Path | None,
    typer.Option(help="Your OpenSim model, which gets this person's hips, knees and ankles."),
]
Names = Annotated[
    Path | None,
    typer.Option(help="For --into: TOML file with the names of its hips, knees and ankles."),
]
Transferred = Annotated[
    str, typer.Option("--parameters", help="For --into: joints, or joints,masses.")
]
Attachments = Annotated[
    str,
    typer.Option(
        help="For --into: stay (muscle points, wraps and meshes keep their positions on the "
        "bones) or follow (they move with the two joints of their bone)."
    ),
]
Muscles = Annotated[
    bool,
    typer.Option(
        "--muscles", help="For --into: muscle lengths and moment arms before and after, by OpenSim."
    ),
]
ModelDraws = Annotated[
    int,
    typer.Option(
        "--draws",
        min=0,
        help="For --into: number of further models, drawn from the standard errors.",
    ),
]
ModelSeed = Annotated[int, typer.Option("--seed", min=0, help="For --draws: seed.")]
Inputs = Annotated[
    Path | None,
    typer.Option(
        help="For c3d: folder of the recordings. Default: beside DIR, or the current folder."
    ),
]
Replace = Annotated[
    bool,
    typer.Option("--replace", help="For c3d: replace another program's outputs of the same names."),
]
Signs = Annotated[
    str | None,
    typer.Option("--convention", help="For cycles: signs, opensim (default) or clinical."),
]
Moments = Annotated[
    str | None,
    typer.Option(
        help="For cycles: axes of moments, coordinates (default), proximal, distal or jcs."
    ),
]
External = Annotated[
    bool, typer.Option("--external", help="For cycles: external instead of internal moments.")
]
Units = Annotated[str | None, typer.Option(help="For cycles: Nm (default), Nm/kg or %BW*H.")]

AnyResult = Annotated[
    Path,
    typer.Argument(
        metavar="DIR", help="Result folder of 'gaitcal calibrate' or 'gaitcal dynamics'."
    ),
]
FiguresFolder = Annotated[
    Path | None, typer.Option("--out", help="Folder for the files. Default: DIR/figures.")
]
Only = Annotated[
    list[str] | None,
    typer.Option(
        "--only",
        metavar="NAME",
        help="Only figures whose names begin or end with these words: knee_adduction, hip, "
        "moment. Repeatable.",
    ),
]
Width = Annotated[str | None, typer.Option(help="85mm (one column; default), 170mm, 17cm, 3.35in.")]
Pictures = Annotated[
    str, typer.Option("--format", help="Comma-separated: svg, pdf, png (300 dpi).")
]
FigureBands = Annotated[
    Path | None,
    typer.Option(
        "--normal",
        help="CSV of normal bands, or schwartz2008. Default: those of the result, if any.",
    ),
]
FigureSigns = Annotated[
    str | None, typer.Option("--convention", help="Signs: clinical (default) or opensim.")
]
FigureExternal = Annotated[
    bool, typer.Option("--external", help="External instead of internal moments.")
]
FigureUnits = Annotated[str | None, typer.Option("--units", help="Nm/kg (default), Nm or %BW*H.")]

Other = Annotated[
    Path | None,
    typer.Argument(metavar="[DIR2]", help="Other session of the same person, to compare both."),
]
OtherResult = Annotated[
    Path | None,
    typer.Argument(
        metavar="[OTHER]",
        help="Result of another session of the same person; differences are OTHER - DIR.",
    ),
]

Pdf = Annotated[
    Path | None,
    typer.Option(
        "--pdf", help="File to write. Default: DIR/report.pdf; required with two results."
    ),
]
Comments = Annotated[
    Path | None,
    typer.Option(
        help="TOML file of comments, one for each section. Default: DIR/comments.toml, if any."
    ),
]
Html = Annotated[
    Path | None,
    typer.Option(help="Write one self-contained page to this file instead of a live view."),
]
Geometry = Annotated[
    Path | None,
    typer.Option(help="Folder of bone surfaces (OpenSim's Geometry). Default: the installed ones."),
]
CodeName = Annotated[
    str | None,
    typer.Argument(metavar="[CODE]", help="Code such as GC-020. Default: list all codes."),
]
