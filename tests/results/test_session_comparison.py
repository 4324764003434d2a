"""Two sessions side by side: identities, a known shift, what is shared, who is compared."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import t as student

from gaitcal.calibration.error_sources import ErrorSources
from gaitcal.calibration.joint_prior import combine_joint_priors, factor_prior, select_prior
from gaitcal.errors import Code
from gaitcal.export.opensim.model_comparison import ComparisonRow, describe_osim_differences
from gaitcal.model.parameters import JP_INDEX
from gaitcal.results.session_comparison import compare_curve_figures, compare_sessions
from gaitcal.results.session_difference import (
    MDC,
    compute_anatomical_root,
    compute_difference_variance,
    compute_placement_errors,
    describe_difference,
    describe_differences,
    format_numbers,
)
from gaitcal.results.stride_sets import Common, StrideSet
from gaitcal.study.settings import ParameterPriorTable
from tests.messages import check_text, refuses
from tests.results.made_sessions import NAMES, SD, SHARED, made_session, placed_anew

EXACT = 1e-9
SWING = 8.0
"""deg."""


def test_a_session_against_itself_differs_in_nothing() -> None:
    session = made_session()
    found = compare_sessions(session, session)
    assert found.common is Common.MODEL
    table = found.differences
    assert len(table) and (table["difference"] == 0.0).all() and not table["exceeds"].any()
    assert (table["se_shared"] == 0.0).all()
    assert (found.curves["difference"].dropna() == 0.0).all() and not found.curves["exceeds"].any()


def test_a_known_shift_comes_first_and_nothing_else_exceeds() -> None:
    a, b = made_session("before"), made_session("after", seed=0, swing=-SWING)
    found = compare_sessions(a, b)
    first = found.found[0]
    assert (first.side, first.name, first.difference) == (
        "r",
        "knee_angle",
        pytest.approx(-SWING, abs=EXACT),
    )
    assert {(d.side, d.name) for d in found.found if d.exceeds} == {("r", "knee_angle")}
    beyond = found.curves[found.curves["exceeds"] == 1]
    assert (
        set(beyond["side"]) == {"r"}
        and beyond["percent"].min() == 61
        and beyond["percent"].max() == 100
    )
    said = next(line for line in found.lines if line.startswith("right knee flexion"))
    check_text(said, 8.0)


def test_the_error_of_a_difference_is_that_of_strides_and_of_what_is_not_shared() -> None:
    a, b = (
        made_session("a", strides=12),
        made_session("b", seed=1, strides=12, statics=("another",)),
    )
    found = compare_sessions(a, b)
    assert found.common is Common.PERSON
    largest = next(
        d
        for d in found.found
        if (d.side, d.name, d.measure) == ("r", "knee_angle", "highest in swing")
    )
    tops = [
        s.strides.query("side == 'r' and variable == 'knee_angle' and percent == 75")["value"]
        for s in (a, b)
    ]
    pooled = sum(((t - t.mean()) ** 2).sum() for t in tops) / 22
    assert pytest.approx(student.ppf(0.975, 10**6), abs=1e-3) == MDC  # 95 % of a normal difference
    widened = student.ppf(0.975, 22) / MDC
    assert largest.se_strides == pytest.approx(widened * np.sqrt(pooled / 6.0), rel=1e-6)
    assert largest.se_shared == pytest.approx(np.sqrt(2.0) * SHARED["knee_angle"], rel=1e-6)
    assert largest.mdc95 == pytest.approx(MDC * np.hypot(largest.se_strides, largest.se_shared))
    assert 0.3 * SD < np.sqrt(pooled) < 3.0 * SD


def test_one_stride_each_is_never_more_than_could_be_missed() -> None:
    found = compare_sessions(made_session("a", strides=1), made_session("b", strides=1, swing=50.0))
    curves = [d for d in found.found if d.kind in ("angle", "moment")]
    assert curves and not any(d.exceeds for d in curves) and not found.curves["exceeds"].any()
    check_text(found.lines)


def test_what_both_share_counts_once() -> None:
    one, other = (made_session(seed=seed).influence for seed in (0, 1))
    assert not compute_difference_variance((one, other), NAMES, Common.MODEL).any()
    markers = [(i.effects[:, :3] ** 2).sum(axis=1) for i in (one, other)]
    static = compute_difference_variance((one, other), NAMES, Common.STATIC)
    assert static == pytest.approx(
        sum(markers), rel=1e-12
    )  # nominal columns are alike: they cancel
    person = compute_difference_variance((one, other), NAMES, Common.PERSON)
    assert person == pytest.approx(
        sum(markers) + 2.0 * compute_placement_errors(NAMES) ** 2, rel=1e-12
    )


def test_of_nominal_errors_the_persons_own_part_counts_once() -> None:
    """Errors K d of d ~ N(m0, P0), of which two static trials have P0 - Q in common: K F are
    columns of causes.
    """
    rng, (_, spread) = np.random.default_rng(5), select_prior(NAMES, None)
    clusters = tuple(f"nominal/{name}" for name in NAMES)
    parts = [rng.normal(size=(len(NAMES), len(NAMES))) for _ in range(2)]
    one, other = (ErrorSources(NAMES, part @ factor_prior(NAMES, None), clusters) for part in parts)
    own, apart = spread - placed_anew(), parts[1] - parts[0]
    wanted = np.diag(apart @ own @ apart.T) + 2.0 * compute_placement_errors(NAMES) ** 2
    assert compute_difference_variance((one, other), NAMES, Common.PERSON) == pytest.approx(
        wanted, rel=1e-9
    )
    wanted = np.diag(apart @ spread @ apart.T)
    assert compute_difference_variance((one, other), NAMES, Common.STATIC) == pytest.approx(
        wanted, rel=1e-9
    )


def test_markers_move_the_place_of_a_bone_end_and_leave_its_two_views_as_far_apart() -> None:
    """6 mm of the 12 that the hip's centre has along x; nothing of the 4 that pelvis and thigh are
    apart.
    """
    assert compute_anatomical_root(NAMES[:2], None) == pytest.approx(
        np.diag([np.sqrt(1.0 - (6.0 / 12.0) ** 2), 1.0]), abs=1e-12
    )
    narrow = combine_joint_priors({name: ParameterPriorTable(deviation=1.0) for name in NAMES[:2]})
    values = np.linalg.eigvalsh(compute_anatomical_root(NAMES[:2], narrow))
    assert values[0] == pytest.approx(0.0, abs=1e-7) and values[1] <= 1.0, (
        "markers are not put better than is known"
    )


def test_refused_and_doubtful_results_are_said_first() -> None:
    a = made_session("a", verdict="doubtful", reasons=("walk: a marker fell off",))
    b = made_session("b", verdict="refused", reasons=("walk: the forces come late",))
    lines = compare_sessions(a, b).lines
    check_text(lines[0])
    check_text(lines[1])


def test_negative_values_are_told_as_more_or_less_negative() -> None:
    found = compare_sessions(made_session("a"), made_session("b", swing=SWING)).found
    peak = replace(found[0], name="ankle_angle_moment", kind="moment", unit="N m", a=-86.0, b=-77.0)
    check_text(describe_difference(peak), 9.0, -77.0, -86.0)
    check_text(describe_difference(replace(peak, a=-77.0, b=-86.0)), 9.0)
    lowest = replace(
        peak, name="knee_adduction_moment", measure="lowest in terminal stance", a=-11.8, b=-8.4
    )
    told = "knee abduction moment, terminal stance: 3.4 N m less (8.4 against 11.8)"
    assert told in describe_difference(lowest) and format_numbers(lowest)[:3] == (
        "11.8",
        "8.4",
        "-3.4",
    ), "in the sense in which it acts"
    same_step = replace(peak, unit="s", a=0.6070, b=0.60696)
    assert format_numbers(same_step)[:3] == ("0.607", "0.607", "0.000")


def test_single_support_is_told_once_as_the_swing_of_the_other_leg() -> None:
    one = compare_sessions(made_session("a"), made_session("b", swing=SWING)).found[0]
    step = replace(
        one,
        se_shared=0.0,
        kind="spatiotemporal",
        measure="mean",
        unit="s",
        a=0.40,
        b=0.46,
        se_strides=0.01,
    )
    legs = [
        replace(step, side=side, name=name)
        for side, name in (("l", "swing"), ("r", "single_support"))
    ]
    lines = describe_differences(("a", "b"), Common.STATIC, legs)
    assert len(lines) == 3
    check_text(lines[2])
    check_text(describe_differences(("a", "b"), Common.STATIC, legs[1:])[2])


def test_a_recording_in_both_is_said() -> None:
    warnings = compare_sessions(
        made_session("a"), made_session("b", recordings=frozenset({"a"}))
    ).warnings
    check_text(warnings, 1)


def test_another_person_is_refused_or_doubted() -> None:
    a, b = made_session("a"), made_session("b", person="S08")
    check_text(compare_sessions(a, b).warnings)
    longer = b.model.parameters.joint.copy()
    for side in "rl":
        longer[JP_INDEX[f"knee_{side}.thigh.sup"]] *= 1.3
    stretched = replace(b.model, parameters=replace(b.model.parameters, joint=longer))
    with refuses(Code.NOT_COMPARABLE):
        compare_sessions(a, replace(b, model=stretched))


def test_strides_that_turn_and_samples_that_do_not_count_are_left_out() -> None:
    a, b = made_session("a"), made_session("b", seed=1, swing=SWING)
    turned = b.strides.assign(turn=40.0)
    found = compare_sessions(a, replace(b, strides=turned))
    assert not [d for d in found.found if d.kind in ("angle", "moment")]
    check_text(found.warnings)
    invalid = b.strides.assign(valid=0)
    assert not [
        d for d in compare_sessions(a, replace(b, strides=invalid)).found if d.kind == "angle"
    ]


def row(quantity: str, difference: float, unit: str = "mm", ours: float = 60.0) -> ComparisonRow:
    return ComparisonRow(
        quantity=quantity, unit=unit, ours=ours, theirs=ours + difference, difference=difference
    )


def test_hips_are_told_before_the_rows() -> None:
    rows = [row("hip_r centre in pelvis, ant", -41.0), row("hip_l centre in pelvis, ant", -43.0)]
    rows += [row("hip_r centre in pelvis, lat", 6.0), row("hip_l centre in pelvis, lat", -8.0)]
    rows += [row("total mass", 3.0, "kg"), row("knee_r axis in thigh_r, front", 1.0, "deg")]
    words = describe_osim_differences(rows)
    check_text(words[0], 42, 41, 43)
    check_text(words, 7, 6, 8)
    check_text(words, 3.0)
    assert not any("axes" in text for text in words)


def test_nothing_to_tell_is_said() -> None:
    (words,) = describe_osim_differences(
        [row("hip_r centre in pelvis, ant", 1.0), row("total mass", 0.1, "kg")]
    )
    check_text(words, 5)


def test_errors_that_both_ends_of_a_range_share_cancel_in_all_their_parts() -> None:
    """What the axes have of them differs between the ends, the whole does not."""
    wave = np.sin(np.linspace(0.0, 2.0 * np.pi, 101))[None]
    found = StrideSet(
        values=10.0 * wave,
        stride_error=0.0 * wave,
        shared=0.0 * wave + 1.0,
        frames=0.5 + 0.4 * wave,
        stance=np.array([60.0]),
    )
    sets = {("r", "pelvis_list"): found}
    ranges = [
        d for d in compare_curve_figures(sets, sets, Common.STATIC) if d.measure.startswith("range")
    ]
    assert ranges and all(d.se_shared == 0.0 for d in ranges)
