"""What of a folder a study comes from: a study file of its own, or the files that its draft reads."""

from __future__ import annotations

from pathlib import Path

from gaitcal.codes import Code
from gaitcal.errors import InputError
from gaitcal.io.toml import read_toml
from gaitcal.session.draft import STUDY, Draft
from gaitcal.session.folder import FileKind, Folder, declares_study


def own_study(folder: Folder) -> Path | None:
    """The study file that lies in a folder; None where none does. InputError for several."""
    own = [f.path for f in folder.files if f.kind is FileKind.STUDY or f.name == STUDY]
    if len(own) > 1:
        names = ", ".join(p.name for p in own)
        raise InputError(
            f"holds {len(own)} study files: {names}; name one of them instead of the folder",
            source=folder.path,
            code=Code.FOLDER,
        )
    return own[0] if own else None


def study_files(folder: Path) -> tuple[Path, ...]:
    """The study files in a folder, found without reading its recordings."""
    return tuple(p for p in sorted(folder.iterdir()) if p.suffix.lower() == ".toml" and p.is_file() and _is_study(p))


def _is_study(path: Path) -> bool:
    if path.name[0] in ".~":
        return False
    try:
        return path.name == STUDY or declares_study(read_toml(path))
    except InputError:
        return False


def files_of(draft: Draft) -> tuple[Path, ...]:
    """The files that a drafted study reads."""
    own = [Path(draft.choice.entry)] if draft.choice and draft.choice.entry.endswith(".toml") else []
    forces = [trial.forces.file.path for trial in draft.trials if trial.forces]
    return (*(trial.file.path for trial in draft.trials), *forces, *own)
