"""Which set labels are of."""

from hypothesis import given, settings
from hypothesis import strategies as st

from gaitcal.intake.choose_marker_set import find_person_prefixes, rank_marker_sets
from gaitcal.model.marker_set import load_marker_set

NAMES = ("gait2354", "rcnl", "conventional73", "plug-in-gait")


@settings(max_examples=20)
@given(
    st.sampled_from(NAMES[:3]),
    st.sampled_from(["_", " ", "-", ""]),
    st.sampled_from(["", "Doe:", "p07:"]),
)
def test_separators_and_prefixes_are_renamed(name: str, separator: str, prefix: str) -> None:
    labels = load_marker_set(name).labels
    spelt = tuple(prefix + m.replace("_", ".").replace(".", separator) for m in labels)
    if len(set(spelt)) < len(labels):
        return
    best = rank_marker_sets([spelt])[0]
    assert best.coverage.left_over == ()
    changed = {old: new for old, new in zip(spelt, labels, strict=True) if old != new}
    assert best.rename == changed


def test_a_label_whose_name_is_taken_is_not_renamed() -> None:
    labels = load_marker_set("gait2354").labels
    best = rank_marker_sets([(*labels, "R_ASIS")])[0]
    assert best.rename == {} and best.clashes == ("R_ASIS",)


def test_measured_markers_of_opencap_are_not_its_video_points() -> None:
    measured = load_marker_set("opencap-measured").labels
    best = rank_marker_sets([(*measured, "RKnee", "LKnee", "RAnkle", "LAnkle", "Neck")])[0]
    known = (best.entry, best.coverage.known, best.rename)
    assert known == ("opencap-measured", len(measured), {}), "not 18 of 55 of Visual3D"
    assert "RKnee" in best.clashes


def test_set_of_the_folder_precedes_a_built_in_one() -> None:
    local_set = load_marker_set("rcnl")
    assert (
        rank_marker_sets([local_set.labels], [("here/own.toml", local_set)])[0].entry
        == "here/own.toml"
    )


def test_files_of_two_protocols_are_kept_apart() -> None:
    one, other = load_marker_set("rcnl").labels, load_marker_set("conventional73").labels
    best, second = rank_marker_sets([one, other, one])[:2]
    assert (best.entry, best.members) == ("rcnl", (0, 2))
    assert (second.entry, second.members) == ("conventional73", (1,))


def test_one_body_has_one_prefix() -> None:
    marker_set = load_marker_set("plug-in-gait")
    anna = (
        "RASI",
        "LASI",
        "RPSI",
        "LPSI",
        "RKNE",
        "LKNE",
        "RANK",
        "LANK",
        "RTOE",
        "LTOE",
        "RHEE",
        "LHEE",
    )
    ben = ("RKNE", "RTIB", "LTIB", "RTHI")
    both = tuple(f"Anna:{m}" for m in anna) + tuple(f"Ben:{m}" for m in ben)
    assert find_person_prefixes(marker_set, both) == ("Anna", "Ben")
    assert find_person_prefixes(marker_set, [f"Anna:{m}" for m in anna] + ["Box:1", "Wand:1"]) == ()
    separate = tuple(f"Anna:{m}" for m in anna) + ("Ben:RTIB", "Ben:RTHI")
    best = rank_marker_sets([separate])[0]
    assert best.people_prefixes == {} and set(best.rename) == {f"Anna:{m}" for m in anna}
    assert set(best.coverage.left_over) == {"Ben:RTIB", "Ben:RTHI"}


LONG_NAMES = {
    "ASI": "ASIS",
    "PSI": "PSIS",
    "THI": "THIGH",
    "KNE": "KNEE",
    "TIB": "TIBIA",
    "ANK": "ANKLE",
}


def test_long_names_with_a_side_before_are_of_plug_in_gait() -> None:
    stems = (*LONG_NAMES, "HEE", "TOE", "SHO", "ELB", "FIN")
    labels = tuple(f"{side}_{LONG_NAMES.get(stem, stem)}" for side in "RL" for stem in stems)
    best = rank_marker_sets([(*labels, "C7", "T10", "CLAV", "STRN")])[0]
    assert (best.entry, best.coverage.left_over, best.certain) == ("plug-in-gait", (), True)


def test_what_is_left_over_makes_a_set_unsure() -> None:
    labels = load_marker_set("plug-in-gait").labels
    assert rank_marker_sets([labels])[0].certain
    assert rank_marker_sets([(*labels, "Bottle", "Wand")])[0].certain, "things are no landmarks"
    assert not rank_marker_sets([(*labels, *(f"thing{i}" for i in range(len(labels))))])[0].certain
    one_sided = rank_marker_sets([(*labels, "RKADX", "LKADX"), labels])[0]
    assert one_sided.sided_unknown == ("RKADX", "LKADX") and not one_sided.certain
    assert rank_marker_sets([(*labels, "RKADX", "LKADX")] * 2)[0].certain, (
        "on every recording: no landmarks of a static trial"
    )
