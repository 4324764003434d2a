"""Which study follows from a folder."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gaitcal.cli.console import Console
from gaitcal.cli.study_folder import find_or_draft_study
from gaitcal.errors import STUDY, Code, Finding, Severity
from gaitcal.intake.draft_file import (
    build_study,
    describe_missing_fields,
    format_draft,
    list_draft_notes,
)
from gaitcal.intake.drafting import draft_study, find_faulty_trials, find_rejected_forces
from gaitcal.intake.people_in_folder import (
    describe_placement_difference,
    find_explaining_swap,
    measure_pair_distances,
)
from gaitcal.intake.recordings_folder import FileKind, Folder, FolderFile
from gaitcal.intake.subject_metadata import KnownField, Options
from gaitcal.intake.trial_movement import check_units
from gaitcal.io.csv_recordings import write_forces_csv
from gaitcal.io.formats import read_recording
from gaitcal.io.opensim_files import write_trc
from gaitcal.io.recording import ForcePlate, Recording
from gaitcal.model.marker_set import load_marker_set
from gaitcal.study.study import Study
from gaitcal.synthetic.synthetic_motion import simulate_gait
from tests.intake.folders import (
    JOINTS,
    SAID,
    draft,
    drafted,
    other_person,
    recordings,
    roles,
    squat,
    write,
)
from tests.messages import check_finding, check_text, refuses
from tests.quality.spoilt import relabelled
from tests.synthetic_studies import made_plates, write_synthetic_study

SNAPSHOT = """\
# Drafted from the folder 'person'. Each line has its reason; check those marked 'likely'.

[subject]
name = "person"  # sure: name of the folder
# mass_kg =   # MISSING: not given in any file; write body mass in kg, and remove the first #
height_m = 1.7  # sure: option
sex = "male"  # sure: option
# age_years =   # not given; mass tables and normative data depend on it
# session_date = "YYYY-MM-DD"   # not given; with birth_date it gives the age
# Optional, for reports and tables: birth_date, diagnosis, affected_side, aids, laboratory

[markers]
set = "gait2354"  # sure: contains 49 of 49 labels of 3 files

[[trial]]
name = "static"  # after the file
role = "static"  # sure: still to 0 mm/s, upright, 0.5 s; @
file = "static.csv"  # 100 frames at 200 Hz

[[trial]]
name = "knee_r"  # after the file
role = "joint"  # sure: joints rotate by knee_r 28 deg RMS
joint = "knee_r"  # the joint that rotates most, see role
file = "knee_r.csv"  # 1200 frames at 200 Hz

[[trial]]
name = "walk"  # after the file
role = "gait"  # sure: the feet move in alternation (correlation -0.86), over 1.3 m
file = "walk.csv"  # 208 frames at 200 Hz
forces = "grf.csv"  # sure: covers the time, centre of pressure under load 4 cm from the feet

# Not used:
#   photo.png: files ending in '.png' are not supported
"""


def test_the_text_of_a_draft(tmp_path: Path) -> None:
    folder = write(tmp_path / "person", recordings("knee_r"), forces="grf")
    (folder / "photo.png").touch()
    made = draft(folder, Options(height=1.70, sex="male"))
    worn = (
        "has markers for the static trial only: "
        "R.Knee.Lat, R.Knee.Med, R.Ankle.Lat, R.Ankle.Med, ..."
    )
    assert format_draft(made, folder) == SNAPSHOT.replace("@", worn)
    assert made.missing == ("mass_kg",)
    (folder / "study.toml").write_text(format_draft(made, folder), encoding="utf-8")
    with refuses(Code.MISSING_FIELD, field="subject.mass_kg", source="study.toml"):
        Study.load(folder / "study.toml")


@pytest.mark.slow
def test_a_drafted_study_loads_and_is_drafted_alike_again(tmp_path: Path) -> None:
    folder = write(tmp_path / "person", recordings(*JOINTS), forces="walk_forces")
    made = draft(folder)
    assert roles(made) == ROLES
    text = format_draft(made, tmp_path / "elsewhere")
    assert format_draft(draft(folder), tmp_path / "elsewhere") == text
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere/study.toml").write_text(text, encoding="utf-8")
    loaded, direct = Study.load(tmp_path / "elsewhere/study.toml"), build_study(made)
    assert [t.name for t in loaded.trials] == [t.name for t in direct.trials]
    assert len(direct.trials[-1].recording.plates) == len(loaded.trials[-1].recording.plates) == 2
    assert "study.toml" not in direct.inputs, "nobody wrote one"
    assert direct.changed_inputs() == ()
    assert set(direct.inputs) == {
        f"{name}.csv" for name in (*JOINTS, "static", "walk", "walk_forces")
    }


@pytest.mark.slow
@settings(max_examples=3)
@given(st.permutations(range(8)))
def test_names_of_files_decide_nothing(order: list[int]) -> None:
    renamed = {f"{number:03d}": name for number, name in zip(order, RECORDINGS, strict=True)}
    read = [
        FolderFile(
            path=Path(f"{new}.csv"),
            name=f"{new}.csv",
            kind=FileKind.RECORDING,
            recording=RECORDINGS[old],
        )
        for new, old in sorted(renamed.items())
    ]
    found = roles(draft_study(Folder(path=Path("x"), files=tuple(read), subfolders=()), SAID))
    assert {renamed[new]: role for new, role in found.items()} == ROLES


RECORDINGS = recordings(*JOINTS)
ROLES = {"static": "static", "walk": "gait"} | {joint: f"joint {joint}" for joint in JOINTS}


def test_what_neither_walks_nor_moves_one_joint_is_a_motion(tmp_path: Path) -> None:
    made = drafted(tmp_path, squat=squat())
    assert roles(made)["squat"] == "motion"
    assert 'role = "motion"' in format_draft(made, tmp_path)


def test_who_stands_when_the_belt_stops_has_not_run(tmp_path: Path) -> None:
    walk = recordings()["walk"]
    displacement = np.nanmean(walk.markers[-1] - walk.markers[0], axis=0) * [1.0, 0.0, 1.0]
    along = (walk.time - walk.time[0]) / np.ptp(walk.time)
    on_belt = walk.markers - along[:, None, None] * displacement
    still = np.repeat(on_belt[-1:], len(walk.time), axis=0)
    later = np.concatenate([walk.time, walk.time + np.ptp(walk.time) + 1.0 / walk.rate])
    stopped = replace(walk, time=later, markers=np.concatenate([on_belt, still]))
    assert roles(drafted(tmp_path, walk=stopped))["walk"] == "gait"


def test_two_people_are_reported_and_stop(tmp_path: Path) -> None:
    files = recordings("hip_r")
    folder = write(
        tmp_path / "both", files | {f"b_{n}": other_person(files[n]) for n in ("static", "walk")}
    )
    made = draft(folder)
    assert set(roles(made)) == {"static", "walk", "hip_r"}, "the one with more recordings"
    check_text(made.problem)
    assert "b_static.csv" in made.problem and "b_walk.csv" in made.problem
    (folder / "b_static.csv").unlink()
    alone = draft(folder)
    assert alone.problem == "", "a stray recording of somebody else is left out"
    assert "b_walk.csv" in [row.name for row in alone.left_out]
    check_text(row.reason for row in alone.left_out if row.name == "b_walk.csv")


def test_one_recording_in_two_formats_counts_once(tmp_path: Path) -> None:
    walk = recordings()["walk"]
    part = walk.frames((walk.time > walk.time[20]) & (walk.time < walk.time[150]))
    folder = write(tmp_path / "person", recordings() | {"part": part}, forces="walk_forces")
    write_trc(
        folder / "a_walk.trc",
        replace(walk, markers=walk.markers[:, ::-1], labels=walk.labels[::-1]),
    )
    made = draft(folder)
    assert [t.role for t in made.trials] == ["static", "gait"]
    assert sum("the same recording as" in row.reason for row in made.left_out) == 2


def test_no_static_trial_is_an_error_and_a_standing_start_is_none(tmp_path: Path) -> None:
    walk = recordings()["walk"]
    waiting = np.repeat(walk.markers[:1], 150, axis=0)
    slow = replace(
        walk, time=np.arange(358) / walk.rate, markers=np.concatenate([waiting, walk.markers])
    )
    made = draft(write(tmp_path / "person", {"walk": walk, "start": slow}))
    check_text(made.fault)
    assert {row.name for row in made.rows} == {"walk.csv", "start.csv"}
    named = draft(write(tmp_path / "person", {"static_and_walk": slow}))
    assert named.fault == "" and not named.trials[0].certain, (
        "what is called static may hold walking"
    )


def test_of_two_statics_the_one_that_shows_more_gives_the_model(tmp_path: Path) -> None:
    static = recordings()["static"]
    markers = static.markers + np.random.default_rng(1).normal(
        0, 0.0005, static.markers.shape
    )  # another take
    markers[:, static.labels.index("R.Heel")] = np.nan
    made = drafted(tmp_path, a_static=replace(static, markers=markers))
    assert [t.name for t in made.trials] == ["static", "a_static", "walk"]


def test_a_session_in_subfolders_is_one(tmp_path: Path) -> None:
    files = recordings()
    for name, recording in (("standing", "static"), ("moving", "walk")):
        write(tmp_path / "person" / name, {recording: files[recording]})
        write_trc(
            tmp_path / f"person/{name}/{name}.trc", files[recording]
        )  # an ending that subfolders are asked for
    made = draft(tmp_path / "person")
    assert sorted(t.role for t in made.trials) == ["gait", "static"]
    assert 'file = "moving/' in format_draft(made, tmp_path / "person")
    write_trc(tmp_path / "person/moving/other.trc", other_person(files["walk"], 1.2))
    check_text(draft(tmp_path / "person").fault, 2, 1)


@pytest.mark.parametrize(
    "content", [{}, {"a.png": b"x", "notes.txt": b"hello"}], ids=["empty", "no recording"]
)
def test_folders_without_a_recording(tmp_path: Path, content: dict[str, bytes]) -> None:
    for name, data in content.items():
        (tmp_path / name).write_bytes(data)
    made = draft(tmp_path)
    check_text(made.fault, *([len(content)] if content else []))
    assert len(made.rows) == len(content)


def test_two_people_in_one_file_make_no_body(tmp_path: Path) -> None:
    def twice(r: Recording) -> Recording:
        labels = tuple(f"{who}:{label}" for who in ("Anna", "Ben") for label in r.labels)
        return replace(
            r,
            markers=np.concatenate([r.markers, r.markers + [0.0, 0.0, 1.5]], axis=1),
            labels=labels,
        )

    made = drafted(tmp_path, **{name: twice(r) for name, r in recordings().items()})
    check_text(made.fault, "static.csv", 2, 1)


def exchanged(recording: Recording, pairs: dict[str, str]) -> Recording:
    """The same recording with labels exchanged."""
    both = pairs | {new: old for old, new in pairs.items()}
    return replace(recording, labels=tuple(both.get(label, label) for label in recording.labels))


@pytest.mark.parametrize("file", ["static", "walk"])
def test_a_walk_with_labels_exchanged_is_of_the_same_person(tmp_path: Path, file: str) -> None:
    made = drafted(
        tmp_path, **{file: exchanged(recordings()[file], {"R.Thigh.Front": "R.Shank.Front"})}
    )
    assert roles(made) == {"static": "static", "walk": "gait"}, [row.reason for row in made.rows]


def test_exchanged_sides_and_exchanged_people(data_dir: Path) -> None:
    marker_set = load_marker_set("plug-in-gait")
    static, walk, other = (
        marker_set.renamed(read_recording(data_dir / name))
        for name in ("pig_c3d/static.c3d", "pig_c3d/gait.c3d", "children/HC031A/straight.c3d")
    )
    pairs = {
        m: "L" + m[1:] for m in walk.labels if m.startswith("R") and "L" + m[1:] in walk.labels
    }
    one, same, sides, child = (
        measure_pair_distances(r, marker_set) for r in (static, walk, exchanged(walk, pairs), other)
    )
    assert describe_placement_difference(one, same, marker_set) == ""
    for other, swap in ((sides, "left and right"), (child, "")):
        assert (
            describe_placement_difference(one, other, marker_set)
            and find_explaining_swap(one, other, marker_set) == swap
        )


def test_a_walk_of_another_person_is_reported_first(tmp_path: Path) -> None:
    files = recordings()
    folder = write(tmp_path / "person", files | {"walk": other_person(files["walk"])})
    made = draft(folder, Options())
    check_text(made.problem, "walk.csv")
    with refuses(Code.FOLDER, "walk.csv", source="person"):
        find_or_draft_study(folder, Options(), Console(quiet=True, verbose=False))
    with refuses(Code.OPTION, source="static.csv"):
        find_or_draft_study(
            next(folder.glob("*.csv")), Options(), Console(quiet=True, verbose=False)
        )
    check_text(describe_missing_fields(made), "subject.mass_kg")


def test_standing_in_a_part_is_reported(tmp_path: Path) -> None:
    files = recordings()
    static, walk = files["static"], files["walk"]
    both = [m for m in static.labels if m in walk.labels]
    parts = [r.markers[:, [r.labels.index(m) for m in both]] for r in (static, walk)]
    parts[1] += parts[0][-1:].mean(axis=1, keepdims=True) - parts[1][:1].mean(axis=1, keepdims=True)
    markers = np.concatenate(parts)
    whole = replace(
        walk, labels=tuple(both), markers=markers, time=np.arange(len(markers)) / walk.rate
    )
    made = draft(write(tmp_path / "person", {"cap1": whole}))
    check_text(made.fault, "cap1.csv")
    check_text(made.rows[0].reason, 0)


def test_lengths_a_thousand_times_too_small_are_named(tmp_path: Path) -> None:
    made = drafted(
        tmp_path, **{name: replace(r, markers=1e-3 * r.markers) for name, r in recordings().items()}
    )
    check_text(made.fault, 1000)


@pytest.mark.parametrize("name", ["static", "walk"])
@pytest.mark.parametrize("factor", [1e-3, 1e-2, 0.1, 10.0, 100.0, 1e3])
def test_a_unit_is_suspected_before_another_person(name: str, factor: float) -> None:
    """One file in another unit than the others, whatever the person does in it."""
    recording = recordings()[name]
    marker_set = load_marker_set("gait2354")
    assert check_units(recording, marker_set) == ""
    fault = check_units(replace(recording, markers=factor * recording.markers), marker_set)
    times, how = max(factor, 1 / factor), "large" if factor > 1 else "small"
    check_text(fault, f"{times:.0f}", f"{how}")


def test_a_walk_in_another_unit_is_left_out_for_it(tmp_path: Path) -> None:
    walk = recordings()["walk"]
    made = drafted(
        tmp_path, **(recordings() | {"walk2": replace(walk, markers=10.0 * walk.markers)})
    )
    (row,) = (row for row in made.rows if row.name.startswith("walk2"))
    assert not row.used
    check_text(row.reason, 10)
    assert "walk" in roles(made)


def test_notes_report_likely_choices_and_unused_files(tmp_path: Path) -> None:
    static = relabelled("R.Knee.Med", "R.Knee.Inner")(recordings()["static"])
    (tmp_path / "person").mkdir()
    (tmp_path / "person/photo.png").touch()
    made = drafted(tmp_path, static=static, squat=squat())
    legs = KnownField(value={"r": 900.0, "l": 910.0}, reason="guess", certain=False)
    notes = list_draft_notes(replace(made, person={**made.person, "leg_length_mm": legs}))
    check_text(notes, "R.Knee.Inner")
    assert any("leg_length_mm = { r = 900, l = 910 }: guess" in note for note in notes), (
        "as the study file has it"
    )
    assert not any("squat.csv" in note for note in notes)
    check_text(notes, "photo.png")


@pytest.fixture(scope="module")
def with_bad_take(tmp_path_factory: pytest.TempPathFactory) -> Study:
    walk = recordings()["walk"]
    again = walk.frames(walk.time > walk.time[60])
    again = replace(again, source="x", markers=again.markers[::-1].copy(), notes=())
    return build_study(drafted(tmp_path_factory.mktemp("x"), other=again))


def error(where: str, severity: Severity = Severity.ERROR) -> Finding:
    found = {"found": "x is wrong", "cure": "do y"}
    return Finding(code=Code.PLATE_OFFSET, severity=severity, topic="plates", where=where, **found)


def test_a_faulty_walk_is_left_out_and_reported(with_bad_take: Study) -> None:
    assert [t.name for t in with_bad_take.trials] == ["static", "other", "walk"]
    faulty = find_faulty_trials(with_bad_take, (error("other"), error("walk", Severity.WARNING)))
    assert faulty == {"other": "plates: x is wrong; do y"}


@pytest.mark.parametrize(
    "where", [("static",), (STUDY,), ("other", "walk"), ("other", "static"), ()]
)
def test_nothing_goes_where_nothing_would_be_left_or_all_is_in_doubt(
    with_bad_take: Study, where: tuple[str, ...]
) -> None:
    assert find_faulty_trials(with_bad_take, [error(name) for name in where]) == {}


FAR = np.array([3.0, 0.0, 0.0])


def with_forces(
    folder: Path, plates: Sequence[ForcePlate], name: str = "walk_grf.csv", **files: Recording
) -> Path:
    write_forces_csv(write(folder / "person", recordings() | files) / name, plates)
    return folder / "person"


def test_the_feet_decide_and_not_the_names(tmp_path: Path) -> None:
    """Two walks at the same times, 3 m apart, and names that lie."""
    walk = recordings()["walk"]
    labels = tuple({"R.": "L.", "L.": "R."}.get(m[:2], m[:2]) + m[2:] for m in walk.labels)
    there = replace(walk, labels=labels, markers=walk.markers[::-1] * [1.0, 1.0, -1.0] + FAR)
    made = draft(with_forces(tmp_path, made_plates(simulate_gait()), "walk2_grf.csv", walk2=there))
    forces = {t.name: t.forces for t in made.trials if t.role == "gait"}
    chosen = forces["walk"]
    assert chosen is not None and chosen.file.name == "walk2_grf.csv"
    assert not chosen.certain
    check_text(chosen.reason, "walk2")
    assert forces["walk2"] is None


def test_unused_forces_are_reported(tmp_path: Path) -> None:
    folder = with_forces(
        tmp_path, [replace(p, point=p.point + FAR) for p in made_plates(simulate_gait())]
    )
    made = draft(folder)
    assert all(t.forces is None for t in made.trials)
    (row,) = (row for row in made.left_out if row.name == "walk_grf.csv")
    check_text(row.reason)
    (warning,) = find_rejected_forces(made)
    assert warning.severity is Severity.WARNING and warning.where == "walk"
    check_finding(warning, Code.FORCES_NOT_USED, "walk_grf.csv")
    (folder / "walk_grf.csv").unlink()
    assert find_rejected_forces(draft(folder)) == (), "a folder without forces is asked for angles"


@pytest.mark.parametrize("kept", [slice(40, None), slice(40, 110)])
def test_forces_that_cover_a_part_are_used_and_cut_nothing(tmp_path: Path, kept: slice) -> None:
    """Most of the walk, and less than half of it; the drafted study reads the whole walk."""
    plates = made_plates(simulate_gait())
    part = [
        replace(p, **{k: getattr(p, k)[kept] for k in ("time", "force", "point", "moment")})
        for p in plates
    ]
    made = draft(with_forces(tmp_path, part))
    forces = made.trials[-1].forces
    assert forces is not None
    check_text(forces.reason, f"{part[0].time[0]:.2f}", f"{part[0].time[-1]:.2f}")
    trial = build_study(made, proposed=True).moving[-1].recording
    assert len(trial.time) == len(recordings()["walk"].time)
    assert sum("no torques beyond" in note for note in trial.notes) == len(part)
    late = with_forces(tmp_path, [replace(p, time=p.time + 100.0) for p in plates])
    assert draft(late).trials[-1].forces is None


@pytest.mark.parametrize(("unit", "factor"), [("mm", 1e3), ("cm", 1e2)])
def test_unit_of_centres_of_pressure_is_reported(tmp_path: Path, unit: str, factor: float) -> None:
    plates = [replace(p, point=factor * p.point) for p in made_plates(simulate_gait())]
    (row,) = (
        row for row in draft(with_forces(tmp_path, plates)).left_out if row.name == "walk_grf.csv"
    )
    check_text(row.reason, unit)


def test_forces_called_after_the_static_trial_are_not_those_of_a_walk(tmp_path: Path) -> None:
    """Even where a walk passes over the same place; and the walk is not said to lack them."""
    made = draft(with_forces(tmp_path, made_plates(simulate_gait()), "static_forces.csv"))
    (row,) = (row for row in made.left_out if row.name == "static_forces.csv")
    assert made.trials[-1].forces is None
    check_text(row.reason, "static.csv")
    assert find_rejected_forces(made) == ()


def test_forces_with_their_time_in_milliseconds_are_refused(tmp_path: Path) -> None:
    path = write_synthetic_study(tmp_path / "study")
    plates = [replace(p, time=1e3 * p.time) for p in made_plates(simulate_gait())]
    write_forces_csv(path.parent / "walk_forces.csv", plates)
    with refuses(Code.PART_OF_TRIAL, field="plate 1", source="walk_forces.csv"):
        Study.load(path)
