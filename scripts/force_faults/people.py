"""The studies that faults are put into, and what is kept of each: its joint stage, done once.

A fault of the forces does not touch the joint parameters, and the motion of its trial only through the say that plates
have in the bandwidth: the motion is reused, or tracked again where that is asked for or markers were changed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from gaitcal.errors import InputError
from gaitcal.model.parameters import Parameters
from gaitcal.model.subject_model import SubjectModel
from gaitcal.motion.motion import Motion, tracked_motion
from gaitcal.person.joint_parameters import joint_stage
from gaitcal.person.prepare import PreparedTrial, forward_direction, measured_reactions, prepare_trial
from gaitcal.recording import turn_to_progression
from gaitcal.recording.recording import Recording
from gaitcal.study.settings import CalibrationSettings
from gaitcal.study.study import Study, nominal_of
from gaitcal.study.study_trial import Role, StudyTrial
from gaitcal.synthetic.subject import synthesize
from gaitcal.verdict.force_evidence import ForceEvidence, force_evidence

CHILDREN = {"HC002D": (32.1, 1.45), "HC030A": (45.8, 1.48), "HC031A": (27.7, 1.33), "HC032A": (60.3, 1.58)}
"""kg and m, as their files say; the sex, which they do not tell, is taken as female throughout."""
LABS = {"kad": (79.25, 1.624, ("walk",)), "multi": (53.5, 1.634, tuple(f"walk0{i}" for i in range(3, 8)))}
SYNTHETIC = (1, 2, 3)


@dataclass(frozen=True, kw_only=True)
class Person:
    """A study after its joint stage."""

    name: str
    model: SubjectModel
    parameters: Parameters
    settings: CalibrationSettings
    trials: tuple[StudyTrial, ...]
    """Gait trials over force plates."""
    motions: tuple[tuple[PreparedTrial, Motion], ...]
    clean: tuple[ForceEvidence, ...]

    def evidence(
        self, number: int, change: Callable[[Recording], Recording], *, track: bool = False
    ) -> ForceEvidence | None:
        """Of the trial of that number, its recording changed; `track`: its motion is sought again."""
        before, motion = self.motions[number]
        trial = replace(self.trials[number], recording=change(self.trials[number].recording))
        if track or trial.recording.markers is not self.trials[number].recording.markers:
            prepared = prepare_trial(trial, self.model, self.settings)
            motion = tracked_motion(prepared.body, self.parameters)
        else:
            turned = turn_to_progression(trial.recording, forward_direction(self.model, trial.recording))
            prepared = replace(before, trial=trial, recording=turned)
        return evidence_of(prepared, motion, self.model, self.parameters, self.settings)


def evidence_of(
    prepared: PreparedTrial, motion: Motion, model: SubjectModel, parameters: Parameters, settings: CalibrationSettings
) -> ForceEvidence | None:
    """What `gaitcal calibrate` looks at."""
    reactions = measured_reactions(prepared, model, parameters, motion, settings)
    return force_evidence(prepared.trial, prepared.recording, model, parameters, motion, reactions)


def person(name: str, study_file: Path) -> Person:
    """Joint stage and clean evidence of a study."""
    study = Study.load(study_file)
    model = nominal_of(study)
    parameters = joint_stage(study, model, lambda text: None, leave_out=False).parameters
    trials, motions, clean = [], [], []
    for trial in study.moving:
        if trial.role is Role.GAIT and trial.recording.plates:
            prepared = prepare_trial(trial, model, study.settings)
            motion = tracked_motion(prepared.body, parameters)
            evidence = evidence_of(prepared, motion, model, parameters, study.settings)
            if evidence is not None:
                trials.append(trial)
                motions.append((prepared, motion))
                clean.append(evidence)
    return Person(
        name=name,
        model=model,
        parameters=parameters,
        settings=study.settings,
        trials=tuple(trials),
        motions=tuple(motions),
        clean=tuple(clean),
    )


def people(data: Path | None, folder: Path, wanted: tuple[str, ...] = ()) -> Iterator[Person]:
    """All that can be read, real ones first; `folder` takes the study files."""
    for name, write in _studies(data, folder).items():
        if wanted and name not in wanted:
            continue
        try:
            yield person(name, write())
        except (InputError, OSError) as fault:
            print(f"{name}: left out: {str(fault)[:150]}")


def _studies(data: Path | None, folder: Path) -> dict[str, Callable[[], Path]]:
    out: dict[str, Callable[[], Path]] = {}
    if data is not None:
        trc = ("subject01_static.trc", "subject01_walk1.trc", "subject01_walk1_grf.mot")
        static, walk, forces = (data / "subject01" / file for file in trc)
        person_01 = ("subject01", 72.6, 1.803, "male", "gait2354", static, {"walk": walk}, forces)
        out["subject01"] = lambda: _written(folder, *person_01)
        pig = data / "pig_c3d"
        person_pig = ("pig_c3d", 66.5, 1.79, "male", "plug-in-gait", pig / "static.c3d", {"gait": pig / "gait.c3d"})
        out["pig_c3d"] = lambda: _written(folder, *person_pig)
        for child in CHILDREN:
            out[child] = lambda child=child: _child(data / "children" / child, folder)
        for lab in LABS:
            out[lab] = lambda lab=lab: _lab(data / "labs_c3d" / lab, folder)
        for simulated in ("p01", "p18"):
            out[simulated] = lambda simulated=simulated: data / "opensim_truth" / simulated / "study.toml"
    for seed in SYNTHETIC:
        target = folder / f"synthetic{seed}"
        out[target.name] = lambda target=target, seed=seed: synthesize(target, seed=seed, noise=True, perturb=seed != 3)
    return out


def _written(
    folder: Path,
    name: str,
    mass: float,
    height: float,
    sex: str,
    markers: str,
    static: Path,
    walks: dict[str, Path],
    forces: Path | None = None,
) -> Path:
    text = f'[subject]\nname = "{name}"\nmass_kg = {mass}\nheight_m = {height}\nsex = "{sex}"\n'
    text += f'[markers]\nset = "{markers}"\n[[trial]]\nname = "static"\nrole = "static"\nfile = "{static.as_posix()}"\n'
    for walk, file in walks.items():
        text += f'[[trial]]\nname = "{walk}"\nrole = "gait"\nfile = "{file.as_posix()}"\n'
        text += f'forces = "{forces.as_posix()}"\n' if forces else ""
    path = folder / f"study_{name}.toml"
    path.write_text(text, encoding="utf-8")
    return path


def _child(data: Path, folder: Path) -> Path:
    """Plug-in Gait with one marker on the sacrum, and none on upper arm and forearm."""
    mass, height = CHILDREN[data.name]
    walks = {name: data / f"{name}.c3d" for name in ("straight", "turn")}
    return _written(folder, data.name, mass, height, "female", "plug-in-gait", data / "static.c3d", walks)


def _lab(data: Path, folder: Path) -> Path:
    """Plug-in Gait with a knee alignment device in the static trial."""
    mass, height, walks = LABS[data.name]
    files = {walk: data / f"{walk}.c3d" for walk in walks}
    return _written(folder, data.name, mass, height, "female", "plug-in-gait", data / "static.c3d", files)
