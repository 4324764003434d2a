"""What a person has to look at in a drafted study, line by line: for the terminal, and for the notes of the result."""

from __future__ import annotations

from gaitcal.session.draft import Draft, left_over_words

LIKELY = "likely, to be looked at: "


def marker_set_line(draft: Draft) -> str:
    """The marker set, how many labels it knows, and those it does not; empty without a set."""
    choice = draft.choice
    if choice is None:
        return ""
    found = choice.explained
    known = f"knows {found.known} of {found.known + len(found.left_over)} labels"
    return f"{'' if choice.certain else LIKELY}marker set: {choice.entry}, {known}{left_over_words(choice)}"


def doubtful_lines(draft: Draft) -> tuple[str, ...]:
    """What is likely only, and which files are not used."""
    out = []
    for trial in draft.trials:
        role = f"{trial.role} {trial.joint}".strip()
        if not trial.certain:
            out.append(f"{LIKELY}{trial.name} as {role}: {trial.reason}")
        if trial.forces is not None and not trial.forces.certain:
            out.append(f"{LIKELY}{trial.forces.file.name} as forces of {trial.name}: {trial.forces.reason}")
    for field, known in draft.person.items():
        if field != "name" and not known.certain:
            out.append(f"{LIKELY}{field} = {known.value}: {known.reason}")
    return (*out, *(f"not used: {row.name}: {row.reason or row.kind}" for row in draft.left_out))


def draft_notes(draft: Draft) -> tuple[str, ...]:
    """How the study was drafted, as notes of a result."""
    told = (line for line in (marker_set_line(draft), *doubtful_lines(draft)) if line)
    return tuple(f"Drafted from the folder: {line}" for line in told)
