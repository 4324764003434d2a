"""Arguments and options that several commands share, or that are long, with their help."""

from pathlib import Path
from typing import Annotated

import typer

Out = Annotated[
    Path, typer.Option("--out", help="Folder for the results; written whole or not at all.")
]
Result = Annotated[
    Path, typer.Argument(metavar="DIR", help="Result folder of 'gaitcal calibrate'.")
]
StudyPath = Annotated[
    Path,
    typer.Argument(
        metavar="STUDY",
        help="Study file, or a folder of one person's recordings, which drafts its own.",
    ),
]
Mass = Annotated[
    float | None,
    typer.Option(help="Body mass in kg, where the recordings of a folder do not say it."),
]
Height = Annotated[float | None, typer.Option(help="Body height in m, the same.")]
Sex = Annotated[str | None, typer.Option(help="female or male, the same.")]
Age = Annotated[float | None, typer.Option(help="Age in years, the same; may be left out.")]
Normal = Annotated[
    Path | None,
    typer.Option(
        help="CSV of normal bands, or schwartz2008; unless given, children's where age and speed "
        "fit them."
    ),
]
Priors = Annotated[
    Path | None,
    typer.Option(
        help="priors.json of a cohort: joint parameters lean on its people instead of on the "
        "literature."
    ),
]
LearnPriors = Annotated[
    bool,
    typer.Option(
        "--learn-priors", help="Learn of all people what joint parameters to expect: priors.json."
    ),
]

ExampleName = Annotated[
    str | None, typer.Argument(metavar="[NAME]", help="Which; without it, all are listed.")
]
ExampleOut = Annotated[
    Path | None, typer.Option("--out", help="Folder for the files; NAME unless given.")
]
Mirror = Annotated[
    str | None,
    typer.Option(
        metavar="URL", help="Address of a copy, https://, http:// or file:///, instead of GitHub."
    ),
]

Recordings = Annotated[
    Path, typer.Argument(metavar="FOLDER", help="Folder of one person's recordings.")
]
StudyOut = Annotated[
    Path | None, typer.Option("--out", help="The study file; FOLDER/study.toml unless given.")
]

People = Annotated[
    Path,
    typer.Argument(
        metavar="COHORT",
        help="Folder with a folder of recordings for each person, or a cohort.toml that names "
        "them.",
    ),
]
CohortOut = Annotated[
    Path,
    typer.Option(
        "--out", help="Folder for results and tables; what is there and unchanged is not run again."
    ),
]
Retry = Annotated[
    bool, typer.Option("--retry", help="Try those again who failed, though nothing changed.")
]
Jobs = Annotated[int, typer.Option(help="Processes; -1: one for every core.")]
Scheduler = Annotated[
    str | None,
    typer.Option("--cluster", help="A running dask scheduler, tcp://host:port, instead."),
]

ResultOrStudy = Annotated[
    Path,
    typer.Argument(metavar="DIR", help="Result folder of 'gaitcal calibrate', or a study folder."),
]
UntilConverged = Annotated[
    bool, typer.Option("--until-converged", help="More draws until mean and CV stay within 2 %.")
]
Expect = Annotated[
    float | None,
    typer.Option(min=0, help="Marker RMS (mm): print the torque errors to expect from it."),
]

HoldOut = Annotated[
    bool,
    typer.Option(
        "--hold-out", help="Report the marker error on blocks of time left out of the fit too."
    ),
]
Plates = Annotated[
    str | None,
    typer.Option(help="Feet on the plates of a single TRIAL, 1=r,2=l or none; else found."),
]
Forces = Annotated[
    Path | None, typer.Option(help="Ground reactions (.mot, .sto, .csv) of a single TRIAL.")
]
Part = Annotated[
    str | None, typer.Option("--time", help="Part of a single TRIAL to use, start,end in seconds.")
]
DynamicsOut = Annotated[
    Path | None, typer.Option("--out", help="Folder for the results; DIR/dynamics unless given.")
]
TrialRole = Annotated[
    str, typer.Option("--role", help="gait, or motion of any other activity, as in a study file.")
]
FilterHz = Annotated[
    str | None,
    typer.Option(help="Cut-off of the force filter in Hz, or none; else as in the calibration."),
]

Seed = Annotated[int, typer.Option(min=0, help="Seed of noise and perturbation.")]
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
        "--movement",
        help="A trial more, of squat, sit-to-stand, jump, run or stairs; may be given several "
        "times.",
    ),
]

MODELS = "osim,urdf,mjcf"
Formats = Annotated[
    str,
    typer.Option(
        "--format",
        help="Comma-separated: osim, urdf, mjcf; c3d for the recordings; cycles for the strides.",
    ),
]
ExportFolder = Annotated[
    Path | None,
    typer.Option(
        "--out", help="Folder for the files; DIR/export unless given. With --into: the file."
    ),
]
Into = Annotated[
    Path | None,
    typer.Option(
        help="An OpenSim model of your own: its hips, knees and ankles become this person's."
    ),
]
Names = Annotated[
    Path | None,
    typer.Option(help="For --into: a TOML file that says which joints of it are meant."),
]
Transferred = Annotated[
    str, typer.Option("--parameters", help="For --into: joints, or joints,masses.")
]
Attachments = Annotated[
    str,
    typer.Option(
        help="For --into: muscle points, wraps and meshes stay on their bones, or follow its two "
        "joints."
    ),
]
Muscles = Annotated[
    bool,
    typer.Option(
        "--muscles", help="For --into: lengths and moment arms before and after, by OpenSim."
    ),
]
ModelDraws = Annotated[
    int,
    typer.Option("--draws", min=0, help="For --into: further models drawn from the error bars."),
]
ModelSeed = Annotated[int, typer.Option("--seed", min=0, help="For --draws: seed of the draws.")]
Inputs = Annotated[
    Path | None,
    typer.Option(help="For c3d: where the recordings lie, if not beside DIR or in this folder."),
]
Replace = Annotated[
    bool,
    typer.Option(
        "--replace", help="For c3d: in place of what another program computed under the same names."
    ),
]
Signs = Annotated[
    str | None,
    typer.Option("--convention", help="For cycles: signs, opensim (unless given) or clinical."),
]
Moments = Annotated[
    str | None,
    typer.Option(
        help="For cycles: along which axes, coordinates (unless given), proximal, distal or jcs."
    ),
]
External = Annotated[
    bool, typer.Option("--external", help="For cycles: external instead of internal moments.")
]
Units = Annotated[str | None, typer.Option(help="For cycles: Nm (unless given), Nm/kg or %BW*H.")]

AnyResult = Annotated[
    Path,
    typer.Argument(
        metavar="DIR", help="Result folder of 'gaitcal calibrate' or 'gaitcal dynamics'."
    ),
]
FiguresFolder = Annotated[
    Path | None, typer.Option("--out", help="Folder for the files; DIR/figures unless given.")
]
Only = Annotated[
    list[str] | None,
    typer.Option(
        "--only",
        metavar="NAME",
        help="Only these, by the words that their names begin or end with: knee_adduction, hip, "
        "moment. Repeatable.",
    ),
]
Width = Annotated[
    str | None, typer.Option(help="85mm (one column, unless given), 170mm, 17cm, 3.35in.")
]
Pictures = Annotated[
    str, typer.Option("--format", help="Comma-separated: svg, pdf, png (300 dpi).")
]
FigureBands = Annotated[
    Path | None,
    typer.Option(
        "--normal",
        help="CSV of normal bands, or schwartz2008; else those of the result, if it has any.",
    ),
]
FigureSigns = Annotated[
    str | None, typer.Option("--convention", help="Signs, clinical (unless given) or opensim.")
]
FigureExternal = Annotated[
    bool, typer.Option("--external", help="External instead of internal moments.")
]
FigureUnits = Annotated[
    str | None, typer.Option("--units", help="Nm/kg (unless given), Nm or %BW*H.")
]

Other = Annotated[
    Path | None,
    typer.Argument(
        metavar="[DIR2]", help="The same person's other session: page or report compare both."
    ),
]
OtherResult = Annotated[
    Path | None,
    typer.Argument(
        metavar="[OTHER]",
        help="Result of the same person's other session; differences are OTHER - DIR.",
    ),
]

Pdf = Annotated[
    Path | None,
    typer.Option(
        "--pdf", help="The file to write; DIR/report.pdf unless given; needed with two results."
    ),
]
Comments = Annotated[
    Path | None,
    typer.Option(
        help="TOML file of comments, a line a section; DIR/comments.toml where that is there."
    ),
]
Html = Annotated[
    Path | None, typer.Option(help="Write one self-contained page instead of a live view.")
]
Geometry = Annotated[
    Path | None,
    typer.Option(help="Bones of this folder (OpenSim's Geometry) instead of the installed ones."),
]
CodeName = Annotated[
    str | None, typer.Argument(metavar="[CODE]", help="As GC-020, of a finding or an error.")
]
