"""What an OpenSim model differs in, in words."""

from gaitcal.compare.comparison import ComparisonRow, osim_words


def row(quantity: str, difference: float, unit: str = "mm", ours: float = 60.0) -> ComparisonRow:
    return ComparisonRow(quantity=quantity, unit=unit, ours=ours, theirs=ours + difference, difference=difference)


def test_hips_are_told_before_the_rows() -> None:
    rows = [row("hip_r centre in pelvis, ant", -41.0), row("hip_l centre in pelvis, ant", -43.0)]
    rows += [row("hip_r centre in pelvis, lat", 6.0), row("hip_l centre in pelvis, lat", -8.0)]
    rows += [row("total mass", 3.0, "kg"), row("knee_r axis in thigh_r, front", 1.0, "deg")]
    words = osim_words(rows)
    assert words[0] == "their hip centres lie 42 mm behind ours (right 41, left 43)"
    assert "their hip centres lie 7 mm further out than ours (right 6, left 8)" in words
    assert "their body weighs 3.0 kg more than ours" in words
    assert not any("axes" in text for text in words)


def test_nothing_to_tell_is_said() -> None:
    (words,) = osim_words([row("hip_r centre in pelvis, ant", 1.0), row("total mass", 0.1, "kg")])
    assert words.startswith("no centre differs by 5 mm")
