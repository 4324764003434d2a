"""Two sessions side by side: identities, a known shift, what is shared, who is compared; one model for both."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.stats import t as student

from gaitcal.calibration.error_sources import ErrorSources
from gaitcal.calibration.joint_prior import prior_of, prior_of_study, prior_root
from gaitcal.compare.comparison import ComparisonRow, osim_words
from gaitcal.compare.difference import MDC, difference_variance, lines_of, numbers_of, own_causes, placement, sentence
from gaitcal.compare.sessions import compare_sessions, curve_figures
from gaitcal.compare.stride_sets import Common, StrideSet
from gaitcal.errors import InputError
from gaitcal.model.parameters import JP_INDEX
from gaitcal.results.shared_model import JointKnowledge, joined, shared_joints
from gaitcal.study.joint_prior import JointPrior
from gaitcal.study.settings import ParameterPriorTable
from tests.compare.made_sessions import NAMES, SD, SHARED, made_session, placed_anew

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
    assert (first.side, first.name, first.difference) == ("r", "knee_angle", pytest.approx(-SWING, abs=EXACT))
    assert {(d.side, d.name) for d in found.found if d.exceeds} == {("r", "knee_angle")}
    beyond = found.curves[found.curves["exceeds"] == 1]
    assert set(beyond["side"]) == {"r"} and beyond["percent"].min() == 61 and beyond["percent"].max() == 100
    said = next(line for line in found.lines if line.startswith("right knee flexion"))
    assert "8.0 deg less" in said and "times what these recordings could miss" in said


def test_the_error_of_a_difference_is_that_of_strides_and_of_what_is_not_shared() -> None:
    a, b = made_session("a", strides=12), made_session("b", seed=1, strides=12, statics=("another",))
    found = compare_sessions(a, b)
    assert found.common is Common.PERSON
    largest = next(d for d in found.found if (d.side, d.name, d.measure) == ("r", "knee_angle", "highest in swing"))
    tops = [s.strides.query("side == 'r' and variable == 'knee_angle' and percent == 75")["value"] for s in (a, b)]
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
    assert any("cannot be judged" in line for line in found.lines)


def test_what_both_share_counts_once() -> None:
    one, other = (made_session(seed=seed).influence for seed in (0, 1))
    assert not difference_variance((one, other), NAMES, Common.MODEL).any()
    markers = [(i.parameters[:, :3] ** 2).sum(axis=1) for i in (one, other)]
    static = difference_variance((one, other), NAMES, Common.STATIC)
    assert static == pytest.approx(sum(markers), rel=1e-12)  # nominal columns are alike: they cancel
    person = difference_variance((one, other), NAMES, Common.PERSON)
    assert person == pytest.approx(sum(markers) + 2.0 * placement(NAMES) ** 2, rel=1e-12)


def test_of_nominal_errors_the_persons_own_part_counts_once() -> None:
    """Errors K d of d ~ N(m0, P0), of which two static trials have P0 - Q in common: K F are columns of causes."""
    rng, (_, spread) = np.random.default_rng(5), prior_of(NAMES, None)
    clusters = tuple(f"nominal/{name}" for name in NAMES)
    parts = [rng.normal(size=(len(NAMES), len(NAMES))) for _ in range(2)]
    one, other = (ErrorSources(NAMES, part @ prior_root(NAMES, None), clusters) for part in parts)
    own, apart = spread - placed_anew(), parts[1] - parts[0]
    wanted = np.diag(apart @ own @ apart.T) + 2.0 * placement(NAMES) ** 2
    assert difference_variance((one, other), NAMES, Common.PERSON) == pytest.approx(wanted, rel=1e-9)
    wanted = np.diag(apart @ spread @ apart.T)
    assert difference_variance((one, other), NAMES, Common.STATIC) == pytest.approx(wanted, rel=1e-9)


def test_markers_move_the_place_of_a_bone_end_and_leave_its_two_views_as_far_apart() -> None:
    """6 mm of the 12 that the hip's centre has along x; nothing of the 4 that pelvis and thigh are apart."""
    assert own_causes(NAMES[:2], None) == pytest.approx(np.diag([np.sqrt(1.0 - (6.0 / 12.0) ** 2), 1.0]), abs=1e-12)
    narrow = prior_of_study({name: ParameterPriorTable(deviation=1.0) for name in NAMES[:2]})
    values = np.linalg.eigvalsh(own_causes(NAMES[:2], narrow))
    assert values[0] == pytest.approx(0.0, abs=1e-7) and values[1] <= 1.0, "markers are not put better than is known"


def test_refused_and_doubtful_results_are_said_first() -> None:
    a = made_session("a", verdict="doubtful", reasons=("walk: a marker fell off",))
    b = made_session("b", verdict="refused", reasons=("walk: the forces come late",))
    lines = compare_sessions(a, b).lines
    assert lines[0].startswith("warning: b is refused") and "the forces come late" in lines[0]
    assert lines[1].startswith("warning: a is doubtful")


def test_negative_values_are_told_as_more_or_less_negative() -> None:
    found = compare_sessions(made_session("a"), made_session("b", swing=SWING)).found
    peak = replace(found[0], name="ankle_angle_moment", kind="moment", unit="N m", a=-86.0, b=-77.0)
    assert "9.0 N m less negative (-77.0 against -86.0)" in sentence(peak)
    assert "9.0 N m more negative" in sentence(replace(peak, a=-77.0, b=-86.0))
    lowest = replace(peak, name="knee_adduction_moment", measure="lowest in terminal stance", a=-11.8, b=-8.4)
    told = "knee abduction moment, terminal stance: 3.4 N m less (8.4 against 11.8)"
    assert told in sentence(lowest) and numbers_of(lowest)[:3] == ("11.8", "8.4", "-3.4"), (
        "in the sense in which it acts"
    )
    same_step = replace(peak, unit="s", a=0.6070, b=0.60696)
    assert numbers_of(same_step)[:3] == ("0.607", "0.607", "0.000")


def test_single_support_is_told_once_as_the_swing_of_the_other_leg() -> None:
    one = compare_sessions(made_session("a"), made_session("b", swing=SWING)).found[0]
    step = replace(one, se_shared=0.0, kind="spatiotemporal", measure="mean", unit="s", a=0.40, b=0.46, se_strides=0.01)
    legs = [replace(step, side=side, name=name) for side, name in (("l", "swing"), ("r", "single_support"))]
    assert "left swing" in (lines := lines_of(("a", "b"), Common.STATIC, legs))[2] and len(lines) == 3
    assert "right single support" in lines_of(("a", "b"), Common.STATIC, legs[1:])[2]


def test_a_recording_in_both_is_said() -> None:
    warnings = compare_sessions(made_session("a"), made_session("b", recordings=frozenset({"a"}))).warnings
    assert any(text.startswith("1 recording in both") for text in warnings)


def test_another_person_is_refused_or_doubted() -> None:
    a, b = made_session("a"), made_session("b", person="S08")
    assert any("of one person? the names differ" in text for text in compare_sessions(a, b).warnings)
    longer = b.model.parameters.joint.copy()
    for side in "rl":
        longer[JP_INDEX[f"knee_{side}.thigh.sup"]] *= 1.3
    stretched = replace(b.model, parameters=replace(b.model.parameters, joint=longer))
    with pytest.raises(InputError, match="not two results of one person: right thigh"):
        compare_sessions(a, replace(b, model=stretched))


def test_strides_that_turn_and_samples_that_do_not_count_are_left_out() -> None:
    a, b = made_session("a"), made_session("b", seed=1, swing=SWING)
    turned = b.strides.assign(turn=40.0)
    found = compare_sessions(a, replace(b, strides=turned))
    assert not [d for d in found.found if d.kind in ("angle", "moment")]
    assert any("no stride that is complete and straight" in text for text in found.warnings)
    invalid = b.strides.assign(valid=0)
    assert not [d for d in compare_sessions(a, replace(b, strides=invalid)).found if d.kind == "angle"]


CLOSE = 1e-5
"""Relative: what is the same in both sessions is it but for 1e-9 of its variance."""
COUNT = len(NAMES)
SAID = prior_of_study({name: ParameterPriorTable(mean=4.0, deviation=9.0) for name in NAMES[:2]})


def made_knowledge(seed: int, prior: JointPrior | None = None) -> tuple[JointKnowledge, np.ndarray, np.ndarray]:
    """With the information S of its markers, and where these alone would have the deviations."""
    rng, (mean, covariance) = np.random.default_rng(seed), prior_of(NAMES, prior)
    half = np.linalg.inv(prior_root(NAMES, None)).T @ rng.normal(0.0, 1.0, (COUNT, COUNT))
    information, at = half @ half.T, rng.normal(0.0, 0.01, COUNT)
    precision = information + np.linalg.inv(covariance)
    deviation = np.linalg.solve(precision, information @ at + np.linalg.solve(covariance, mean))
    nominal = rng.normal(0.0, 1.0, COUNT)
    known = JointKnowledge(nominal=nominal, fitted=nominal + deviation, covariance=np.linalg.inv(precision))
    return known, information, at


@pytest.mark.parametrize("prior", [None, SAID], ids=["anatomy", "study"])
@pytest.mark.parametrize("anew", [False, True], ids=["one static trial", "two"])
def test_both_sessions_together_are_the_dense_normal_distribution(anew: bool, prior: JointPrior | None) -> None:
    """[d_A, d_B] ~ N([m0, m0], [P0, P0 - Q; P0 - Q, P0]), of which the markers see m = d + noise of S^-1."""
    (a, of_a, at_a), (b, of_b, at_b) = made_knowledge(0, prior), made_knowledge(1, prior)
    found = joined(NAMES, a, b, placed_anew=anew, prior=prior)
    mean, own = prior_of(NAMES, prior)
    same = own - (placed_anew() if anew else 0.0)
    whole = np.block([[own, same], [same, own]])
    gain = whole @ np.linalg.inv(whole + block_diag(np.linalg.inv(of_a), np.linalg.inv(of_b)))
    expected = np.tile(mean, 2) + gain @ (np.concatenate([at_a, at_b]) - np.tile(mean, 2))
    errors = np.sqrt(np.diag(whole - gain @ whole))
    assert np.concatenate([found.a - a.nominal, found.b - b.nominal]) == pytest.approx(expected, rel=CLOSE)
    assert np.concatenate(found.errors) == pytest.approx(errors, rel=CLOSE)
    if not anew:
        precision = of_a + of_b + np.linalg.inv(own)
        assert errors == pytest.approx(np.tile(np.sqrt(np.diag(np.linalg.inv(precision))), 2), rel=CLOSE)


def test_markers_put_on_anew_leave_joints_apart_and_bars_no_wider_than_alone() -> None:
    (a, *_), (b, *_) = made_knowledge(0), made_knowledge(1)
    found = joined(NAMES, a, b, placed_anew=True)
    assert np.abs((found.a - a.nominal) - (found.b - b.nominal)).max() > 1e-4
    for errors, alone, other in zip(found.errors, (a, b), (b, a), strict=True):
        assert (errors <= np.sqrt(np.diag(alone.covariance)) * (1.0 + CLOSE)).all()
        assert (errors < np.sqrt(np.diag(alone.covariance))).any(), other


def test_error_bars_hold_what_is_drawn_from_the_priors() -> None:
    """Many people: deviations that go together but for where markers were put, and noise of the markers."""
    rng, (mean, covariance) = np.random.default_rng(3), prior_of(NAMES, None)
    (_, of_a, _), (_, of_b, _) = made_knowledge(0), made_knowledge(1)
    anew, z = placed_anew(), []
    for _ in range(2000):
        person = rng.multivariate_normal(mean, covariance - anew)
        sessions = []
        for information in (of_a, of_b):
            true = person + rng.multivariate_normal(np.zeros(COUNT), anew)
            at = rng.multivariate_normal(true, np.linalg.inv(information))
            errors = np.linalg.inv(information + np.linalg.inv(covariance))
            fitted = errors @ (information @ at + np.linalg.solve(covariance, mean))
            sessions.append((true, JointKnowledge(nominal=np.zeros(COUNT), fitted=fitted, covariance=errors)))
        found = joined(NAMES, sessions[0][1], sessions[1][1], placed_anew=True)
        z.append([(found.a - sessions[0][0]) / found.errors[0], (found.b - sessions[1][0]) / found.errors[1]])
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.03)  # 16000 draws, which go together in fours


def test_a_refused_session_has_no_say() -> None:
    with pytest.raises(InputError, match="b: is refused"):
        shared_joints(made_session("a"), made_session("b", verdict="refused"), Common.STATIC)
    with pytest.raises(InputError, match="not calibrated"):
        shared_joints(made_session("a", influence=None), made_session("b"), Common.STATIC)
    with pytest.raises(InputError, match="their studies expect other joints"):
        shared_joints(made_session("a"), made_session("b", prior=SAID), Common.STATIC)


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


def test_errors_that_both_ends_of_a_range_share_cancel_in_all_their_parts() -> None:
    """What the axes have of them differs between the ends, the whole does not."""
    wave = np.sin(np.linspace(0.0, 2.0 * np.pi, 101))[None]
    found = StrideSet(
        values=10.0 * wave, own=0.0 * wave, shared=0.0 * wave + 1.0, frames=0.5 + 0.4 * wave, stance=np.array([60.0])
    )
    sets = {("r", "pelvis_list"): found}
    ranges = [d for d in curve_figures(sets, sets, Common.STATIC) if d.measure.startswith("range")]
    assert ranges and all(d.se_shared == 0.0 for d in ranges)
