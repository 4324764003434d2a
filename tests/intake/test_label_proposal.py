"""Markers whose labels say nothing: told by where they are and what they move with."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gaitcal.cli.console import Console
from gaitcal.cli.study_folder import draft_study_file, find_or_draft_study
from gaitcal.errors import Code
from gaitcal.intake.draft_file import build_study, list_uncertain_choices
from gaitcal.intake.drafting import draft_folder
from gaitcal.intake.label_proposal import LANDMARK_SET, LabelProposal, propose_labels
from gaitcal.intake.recordings_folder import read_folder
from gaitcal.intake.subject_metadata import Options
from gaitcal.intake.unnamed_markers import estimate_forward_direction, measure_standing_points
from gaitcal.io.formats import read_recording
from gaitcal.io.recording import Recording
from gaitcal.model.linkage import LOWER_BODY
from gaitcal.model.marker_set import SEGMENT_OF, load_marker_set
from gaitcal.study.study import Study
from scripts.validation.clinics.check import own_set
from tests.intake.folders import SAID, draft, recordings, write
from tests.messages import check_text, refuses
from tests.quality.spoilt import gone, without
from tests.synthetic_studies import only

QUIET = Console(quiet=True, verbose=False)


def nameless(
    files: Mapping[str, Recording], seed: int = 0
) -> tuple[dict[str, Recording], dict[str, str]]:
    """Labels M01, M02, ... in another order in each file; and new label -> old one."""
    rng = np.random.default_rng(seed)
    known = sorted({label for r in files.values() for label in r.labels})
    names = {
        label: f"M{k + 1:02d}" for label, k in zip(known, rng.permutation(len(known)), strict=True)
    }
    out = {}
    for name, r in files.items():
        order = rng.permutation(len(r.labels))
        out[name] = replace(
            r, labels=tuple(names[r.labels[i]] for i in order), markers=r.markers[:, order]
        )
    return out, {new: old for old, new in names.items()}


def list_segments(proposal: LabelProposal) -> dict[str, str]:
    """Label -> segment."""
    landmarks = load_marker_set(LANDMARK_SET)
    segment_of = {
        m: SEGMENT_OF[name]
        for name in landmarks.landmarks
        for option in landmarks.options(name)
        for m in option
    }
    segment_of |= landmarks.segment_of | {
        m: SEGMENT_OF[k] for k, parts in landmarks.knee_device.items() for m in parts
    }
    segments = {label: segment_of[name] for label, name in proposal.rename.items()}
    return segments | {
        label: segment for segment, group in proposal.tracking.items() for label in group
    }


def turned(r: Recording, angle: float, size: float = 1.0) -> Recording:
    """About the vertical, and of a person of another size."""
    return replace(r, markers=size * r.markers @ Rotation.from_euler("y", angle).as_matrix().T)


def proposed(files: Mapping[str, Recording], **changed: Recording) -> LabelProposal:
    return propose_labels([*(dict(files) | changed).values()])


@pytest.mark.parametrize(("angle", "size"), [(0.0, 1.0), (2.1, 0.72)])
def test_segments_of_labels_that_say_nothing(angle: float, size: float) -> None:
    files, old = nameless({name: turned(r, angle, size) for name, r in recordings().items()})
    found, marker_set = proposed(files), load_marker_set("published")
    right = marker_set.segment_of
    wrong = {
        old[m]: segment for m, segment in list_segments(found).items() if segment != right[old[m]]
    }
    assert all(right[m].startswith("upper_arm") for m in wrong) and len(wrong) <= 2, (
        "arms hang still in this walk"
    )
    wanted = {
        m: name
        for name, group in marker_set.landmarks.items()
        if SEGMENT_OF[name] in LOWER_BODY
        for m in group
    }
    named = {old[m]: name for m, name in found.rename.items()}
    assert {m: named.get(m) for m in wanted} == wanted
    assert set(found.evidence) == set(old) and not found.unused


def test_a_walk_tells_which_way_is_forward() -> None:
    files = recordings()
    labels = files["static"].labels
    points = measure_standing_points(files["static"], labels)
    ahead = estimate_forward_direction([files["walk"]], points, labels)
    assert ahead[0] > 0.8 and abs(ahead[1]) < 0.1, "x, as both feet say"
    walk = turned(files["walk"], 1.0)
    assert estimate_forward_direction([walk], points, labels) == pytest.approx(ahead, abs=1e-9), (
        "wherever the walk leads"
    )
    isolated = recordings("hip_r")["hip_r"]
    assert estimate_forward_direction([walk, isolated], points, labels) == pytest.approx(
        ahead, abs=2e-3
    ), "one foot is mute"
    assert estimate_forward_direction([on_the_spot(walk)], points, labels)[0] > 0.8, (
        "on a treadmill, too"
    )
    assert estimate_forward_direction([isolated], points, labels) == pytest.approx(0, abs=1e-3), (
        "one foot"
    )
    backward = replace(walk, markers=walk.markers[::-1])
    assert estimate_forward_direction([backward], points, labels)[0] < -0.8


def test_a_walk_backward_alone_does_not_exchange_the_sides() -> None:
    """Nor do labels that name other markers in another file go unnoticed."""
    files, _ = nameless(recordings())
    walk = files["walk"]
    with refuses(Code.LANDMARKS):
        proposed(files, walk=replace(walk, markers=walk.markers[::-1]))
    shuffled = replace(
        walk, labels=tuple(np.random.default_rng(0).permutation(walk.labels).tolist())
    )
    with refuses(Code.LANDMARKS):
        proposed(files, walk=shuffled)


def test_points_at_rest_in_the_room_are_not_on_the_person() -> None:
    files, _ = nameless(recordings())
    room = np.array([[0.3, 0.45, z] for z in np.linspace(1.2, 2.1, 4)])

    # As on a treadmill.
    files["walk"] = on_the_spot(files["walk"])
    alone = proposed(files)
    found = proposed(
        {
            name: with_points(r, np.repeat(room[None], len(r.time), axis=0))
            for name, r in files.items()
        }
    )
    assert list(found.unused) == ["X1", "X2", "X3", "X4"], "in the order of the files, in every run"
    (reason,) = set(found.unused.values())
    check_text(reason)
    assert found.rename == alone.rename and found.tracking == alone.tracking
    heel = next(m for m, name in alone.rename.items() if name == "heel_r")
    lost = proposed(files, walk=gone(slice(8, None), heel)(files["walk"]))
    assert lost.rename[heel] == "heel_r", "seen while it hardly moves"


def on_the_spot(r: Recording) -> Recording:
    return replace(r, markers=r.markers - r.markers.mean(axis=1, keepdims=True) * [1, 0, 1])


def with_points(r: Recording, points: np.ndarray) -> Recording:
    """With X1, X2, ... at (nf, n, 3) m."""
    added = (f"X{i + 1}" for i in range(points.shape[1]))
    return replace(
        r, labels=(*r.labels, *added), markers=np.concatenate([r.markers, points], axis=1)
    )


def test_a_proposal_is_confirmed_before_anything_is_computed(tmp_path: Path) -> None:
    files, old = nameless(recordings())
    folder = write(tmp_path / "person", files)
    with refuses(Code.UNKNOWN_LABEL, source="person"):
        find_or_draft_study(folder, SAID, QUIET)
    with refuses(Code.UNKNOWN_LABEL, source="person"):
        build_study(draft(folder))
    draft_study_file(QUIET, folder, mass=SAID.mass, height=SAID.height, sex=SAID.sex)
    study = folder / "study.toml"
    with refuses(Code.UNKNOWN_LABEL, field="markers.confirmed", source="study.toml"):
        Study.load(study)
    text = study.read_text(encoding="utf-8")
    study.write_text(text.replace("confirmed = false", "confirmed = true"), encoding="utf-8")
    loaded, right = Study.load(study), load_marker_set("published").segment_of
    assert len(loaded.marker_set.tracked) == len(right)
    back = {name: label for label, name in loaded.rename.items()}
    for label, segment in loaded.marker_set.segment_of.items():
        assert right[old[back.get(label, label)]] == segment
    assert [t.role.value for t in loaded.trials] == ["static", "gait"]


def test_too_few_markers_are_reported(tmp_path: Path) -> None:
    files, _ = nameless(recordings())
    few = {name: only(r, lambda m, r=r: m in r.labels[:7]) for name, r in files.items()}  # type: ignore[misc]
    fault = draft(write(tmp_path / "few", few)).fault
    check_text(fault, 10)


def test_a_landmark_that_lacks_is_not_taken_from_a_marker_nearby() -> None:
    files, old = nameless(recordings())
    lateral = next(m for m, name in old.items() if name == "R.Knee.Lat")
    found = proposed({name: without(lateral)(r) for name, r in files.items()})
    taken = [m for m, name in found.rename.items() if name == "knee_lat_r"]
    assert set(taken) <= found.asked, [old[m] for m in taken]


def test_points_of_a_program_are_no_landmarks() -> None:
    files, _ = nameless(recordings())
    rng = np.random.default_rng(0)
    # Made-up segments are rigid, unless skin moves.
    for name, r in files.items():
        sway = 0.002 * rng.normal(size=r.markers[:1].shape)
        skin = r.markers + sway * np.sin(np.arange(len(r.time)) / 20)[:, None, None]
        heel = skin[:, [0]] + [0.0, 0.0, 0.01]
        files[name] = with_points(
            replace(r, markers=skin), np.concatenate([heel, heel + 0.01], axis=1)
        )
    found = proposed(files)
    assert all("computed" in found.unused[m] for m in ("X1", "X2"))


@pytest.mark.slow
@pytest.mark.parametrize("person", ["labs_c3d/kad", "pig_c3d", "subject01", "children/HC002D"])
def test_segments_in_real_recordings(person: str, data_dir: Path) -> None:
    paths = [p for p in sorted((data_dir / person).iterdir()) if p.suffix in (".c3d", ".trc")]
    known_set = load_marker_set("gait2354" if person == "subject01" else "plug-in-gait")
    right = known_set.segment_of
    files = {}
    for recording in (known_set.renamed(read_recording(p)) for p in paths):
        files[recording.source] = only(recording, lambda label: label in right)
    files, old = nameless(files)
    proposal = proposed(files)
    found = {old[m]: segment for m, segment in list_segments(proposal).items()}
    sacral = {
        old[m]: name for m, name in proposal.rename.items() if name.startswith(("psis", "sacrum"))
    }
    pair = {"RPSI": "psis_r", "LPSI": "psis_l"}
    assert sacral == {
        m: pair.get(m, "sacrum") for m in old.values() if m in pair or m in ("SACR", "V.Sacral")
    }
    wrong = {
        m: (right[m], found.get(m, "nowhere")) for m in old.values() if found.get(m) != right[m]
    }
    assert len(wrong) <= 0.05 * len(old), wrong
    assert not [m for m, (a, b) in wrong.items() if a[:-1] == b[:-1] and a != b], (
        "a leg for the other"
    )


def test_a_cluster_of_the_thigh_is_no_hand(data_dir: Path) -> None:
    """Of legs alone, where hands hang beside the thigh."""
    known_set, folder = own_set("mt_feet"), data_dir / "more_labs" / "mt_feet"
    both = [known_set.renamed(read_recording(folder / name)) for name in ("static.trc", "walk.trc")]
    found = list_segments(
        propose_labels([only(r, lambda label: label in known_set.labels) for r in both], 1.59)
    )
    assert {found[f"L.TH{k}"] for k in (1, 2, 3, 4)} == {"thigh_l"}


def test_markers_that_a_set_does_not_know_follow_what_they_move_with(tmp_path: Path) -> None:
    strange = {
        "R.Thigh.Rear": "X1",
        "L.Shank.Front": "X2",
        "R.Midfoot.Sup": "X3",
        "R.Ankle.Med": "X4",
    }
    files = {
        n: replace(r, labels=tuple(strange.get(m, m) for m in r.labels))
        for n, r in recordings().items()
    }
    made = draft(write(tmp_path / "person", files))
    assert (
        made.choice is not None
        and made.choice.further_markers is not None
        and made.choice.entry == "gait2354"
    )
    assert made.choice.further_markers.tracking == {
        "thigh_r": ("X1",),
        "shank_l": ("X2",),
        "foot_r": ("X3",),
    }
    assert set(made.choice.further_markers.unused) == {"X4"}
    reason = made.choice.further_markers.unused["X4"]
    check_text(reason, "ankle_med_r")
    check_text(" ".join(list_uncertain_choices(made)), "thigh_r", f"X4 ({reason})")
    study = build_study(made)
    assert study.marker_set.segment_of["X1"] == "thigh_r" and study.marker_set.weight("X1") == 1
    with refuses(Code.MARKER_SET, "X1", "foot_l", "thigh_r", field="markers.tracking"):
        study.marker_set.with_further({"foot_l": ["X1"]})
    with refuses(Code.UNKNOWN_FIELD, "tigh_r", "'thigh_r'", field="markers.tracking"):
        study.marker_set.with_further({"tigh_r": ["X9"]})


@pytest.mark.slow
def test_points_that_a_program_computed_are_no_markers(data_dir: Path) -> None:
    made = draft_folder(read_folder(data_dir / "children/HC032A"), Options(sex="male"))
    assert made.choice is not None and made.choice.further_markers is not None
    found = made.choice.further_markers
    for side, segment in (("R", "foot_r"), ("L", "foot_l")):
        assert {f"{side}CPG", f"{side}STL"} <= set(found.tracking[segment]), (
            "of the Oxford foot model"
        )
        axes = [f"{side}{name}{k}" for name in ("FOF", "HDF") for k in range(4)]
        assert all("computed" in found.unused[label] for label in axes), "its segments' axes"
    assert set(found.tracking) == {"foot_r", "foot_l"}
    check_text(found.unused["RNAV"])
