"""What the page says of the numbers: verdicts, largest changes, signs, and the order of markers."""

import json
from dataclasses import replace

import numpy as np
import pytest

from gaitcal.analysis.result import Calibration, Stage, TrialResult
from gaitcal.analysis.trial_result import RmsErrors
from gaitcal.analysis.truth_errors import (
    CurveTruth,
    CurveTruths,
    FeatureTruth,
    ParameterTruth,
    TruthErrors,
)
from gaitcal.calibration.joint_prior import combine_joint_priors
from gaitcal.errors import Severity
from gaitcal.gait.moments import describe_parameter
from gaitcal.gait.strides import list_strides
from gaitcal.model.linkage import COORDINATE_INDEX
from gaitcal.model.parameters import JP_INDEX, JP_NAMES
from gaitcal.quality.force_diagnosis import check_pelvis_residual
from gaitcal.report.page.joint_sections import build_joint_blocks
from gaitcal.report.page.key_figures import build_top_lines
from gaitcal.report.page.page_data import build_result_sections
from gaitcal.report.page.plain_data import Block, format_number
from gaitcal.report.page.trust_sections import collect_marker_fits
from gaitcal.results import stride_uses
from gaitcal.results.parameter_labels import (
    compute_range_of_motion,
    describe_unidentifiable,
    group_joint_parameters,
    summarise_fitted,
)
from gaitcal.results.stride_tables import build_stride_tables
from gaitcal.results.stride_uses import collect_stride_uses, summarise_usable_strides
from gaitcal.study.normal_prior import JointPrior
from gaitcal.study.settings import CalibrationSettings, ParameterPriorTable, Protocol
from tests.fake_result import FRAMES, fake_calibration, held
from tests.report.page.walked_blocks import headings, rows_of, tables, walked, words

SAID = CalibrationSettings(
    joint_prior={name: ParameterPriorTable(deviation=3.0) for name in JP_NAMES}
)


def agreement(calibration: Calibration) -> dict[str, str]:
    """The line of how model, markers and forces agree."""
    tables = build_stride_tables(calibration.model, calibration.trials)
    return build_top_lines(calibration, tables)[1]


def with_final(calibration: Calibration, **changes: np.ndarray) -> Calibration:
    """Other generalised forces with the calibrated model, in the one gait trial."""
    walk, *others = calibration.trials
    moments = {**walk.loads.moments, Stage.JP_IP: replace(walk.loads.final, **changes)}
    assert walk.loads.final is walk.loads.moments[Stage.JP_IP]
    return replace(
        calibration, trials=(replace(walk, loads=replace(walk.loads, moments=moments)), *others)
    )


@pytest.mark.parametrize(("floor", "tone"), [(1.0, "good"), (0.7, "plain"), (0.5, "plain")])
def test_the_tone_follows_from_error_over_floor(
    whole: Calibration, floor: float, tone: str
) -> None:
    """6 mm over what each joint reaches, 5 mm times `floor`; over the rigid floor where there is no
    joint.
    """
    walk, *others = whole.trials
    nearer = replace(walk.floor, distance=floor * walk.floor.distance)
    lower = replace(walk.floor, distance=0.1 * walk.floor.distance)
    by_joints = replace(
        walk, floor=lower, joint_floor=replace(walk.joint_floor, errors=nearer), loads=None
    )
    for trial in (by_joints, replace(walk, floor=nearer, joint_floor=None, loads=None)):
        line = agreement(replace(whole, trials=(trial, *others)))
        assert line["tone"] == tone and line["text"].startswith("Marker fit ")


def test_a_ratio_is_error_over_floor() -> None:
    fit = RmsErrors(label="leg", nominal=9.0, calibrated=6.0, floor=4.0)
    assert fit.ratio == pytest.approx(1.5)
    assert replace(fit, rigid=False).ratio is None


@pytest.mark.parametrize(("part", "factor"), [("residual_force", 20.0), ("residual_moment", 60.0)])
def test_one_residual_above_its_limit_is_beyond_its_errors(
    whole: Calibration, part: str, factor: float
) -> None:
    assert (agreement(whole)["tone"], "too high" in agreement(whole)["text"]) == ("good", False)
    final = whole.trials[0].loads
    larger = with_final(whole, **{part: factor * getattr(final.final, part)})
    larger = replace(larger, trials=(held(larger.trials[0]), *larger.trials[1:]))
    assert (agreement(larger)["tone"], "too high" in agreement(larger)["text"]) == ("look", True)
    loads = larger.trials[0].loads
    (told,) = check_pelvis_residual("walk", loads.expected, trunk_observed=True)
    assert told.severity is Severity.WARNING and told.weight > 1.0, (
        "what the page holds up, the verdict does"
    )
    assert (
        f"{loads.expected.force.limit:.0f} N or {loads.expected.moment.limit:.0f} N·m" in told.found
    )


def test_numbers_are_set_with_minus_signs_and_thin_spaces() -> None:
    assert format_number(-1234.56) == "\N{MINUS SIGN}1\u202f234.6"
    assert (
        format_number(0.04, 1, True) == "0.0"
        and format_number(0.06, 1, True) == "+0.1"
        and format_number(-0.04) == "0.0"
    )
    assert format_number(None) == format_number(float("nan")) == "\N{EN DASH}"


def test_markers_with_little_weight_come_last_and_the_worst_first(whole: Calibration) -> None:
    walk = whole.trials[0]
    errors = walk.calibrated.errors
    size = np.linspace(1.0, 2.0, len(errors.labels))
    weight = np.ones(len(errors.labels))
    weight[-1] = 0.5
    weighted = replace(
        walk.calibrated, errors=replace(errors, distance=errors.distance * size, weight=weight)
    )
    assert [m.label for m in collect_marker_fits(replace(walk, calibrated=weighted))] == [
        *reversed(errors.labels[:-1]),
        errors.labels[-1],
    ]


def test_a_change_is_fitted_minus_nominal(whole: Calibration) -> None:
    rows = {
        row.name: row
        for group in group_joint_parameters(whole)
        for row in (*group.right, *group.left)
    }
    assert rows["hip_l.pelvis.ant"].change == pytest.approx(4.0)  # mm
    assert (rows["hip_l.pelvis.ant"].side, rows["hip_l.pelvis.ant"].part) == ("l", "hip")


@pytest.mark.parametrize(
    ("settings", "learnt", "kept"),
    [
        (CalibrationSettings(protocol="published"), None, "keep their nominal values"),
        (CalibrationSettings(), None, "stay near their nominal values"),
        (CalibrationSettings(), False, "stay near their nominal values"),
        (CalibrationSettings(), True, "stay near the cohort mean"),
        (SAID, None, "stay near the prior mean of the study file"),
        (SAID, True, "stay near the cohort mean"),
    ],
)
def test_what_becomes_of_an_unseen_parameter(
    whole: Calibration, settings: CalibrationSettings, learnt: bool | None, kept: str
) -> None:
    """`learnt`: by a cohort, of all of them; one that teaches nothing leaves them at their nominal
    values.
    """
    prior = None
    if learnt is not None:
        names = whole.unidentifiable if learnt else ()
        count = len(names)
        prior = JointPrior(
            names=names,
            mean=np.zeros(count),
            covariance=1e-4 * np.eye(count),
            file="priors.json",
            people=12,
        )
    used = combine_joint_priors(settings.joint_prior, prior)
    person = replace(
        whole,
        study=replace(whole.study, settings=settings, joint_prior=prior),
        joint_prior=used if settings.decided_by is Protocol.EVIDENCE else None,
    )
    assert any(kept in sentence for sentence in describe_unidentifiable(person))
    ending = summarise_fitted(person)
    assert ending.endswith("All others keep their nominal values.")
    assert ("stays near the cohort mean" in ending) == bool(learnt)
    shown = json.dumps(build_joint_blocks(person))
    assert ("12 people of a cohort (priors.json)" in shown) == (prior is not None)


def test_an_unseen_parameter_that_a_cohort_moves_is_shown(whole: Calibration) -> None:
    name = whole.unidentifiable[0]
    words = describe_parameter(name) + ", not determined"
    assert words not in json.dumps(build_joint_blocks(whole))
    moved = whole.model.parameters.with_joint(
        (name,), whole.nominal.parameters.joint[[JP_INDEX[name]]] + 0.1
    )
    person = replace(whole, model=whole.model.with_parameters(moved))
    (row,) = [
        row
        for g in group_joint_parameters(person)
        for row in (*g.right, *g.left)
        if row.name == name
    ]
    shown = json.dumps(build_joint_blocks(person))
    assert words in shown and f'"{row.fitted:.1f}"' in shown


@pytest.mark.parametrize(
    ("share", "advice"),
    [(0.01, "are needed. Add a functional (single-joint) trial"), (1.0, "not observable from")],
)
def test_what_would_show_an_unseen_parameter(whole: Calibration, share: float, advice: str) -> None:
    """The subtalar joint moves by some 34 degrees, or by a hundredth of that."""
    walk = whole.trials[0]
    still = replace(walk.calibrated, coefficients=share * walk.calibrated.coefficients)
    person = replace(whole, trials=(replace(walk, calibrated=still),))
    angle = np.degrees(walk.body.q[:, COORDINATE_INDEX["subtalar_angle_r"]])
    assert compute_range_of_motion(person, "subtalar_r") == pytest.approx(share * np.ptp(angle))
    (sentence,) = [text for text in describe_unidentifiable(person) if "subtalar" in text]
    assert advice in sentence


@pytest.fixture(scope="module")
def walk(whole: Calibration) -> TrialResult:
    """Two right strides and one left, every frame of both legs valid, each foot on a plate of its
    own.
    """
    trial = next(t for t in whole.trials if t.joint is None)
    reactions, frames = trial.loads.reactions, len(trial.body.time)
    steps = (("1", 0, slice(0, frames)), ("2", 1, slice(0, frames)))
    whole_legs = np.ones((frames, 2), dtype=bool)
    return replace(
        trial,
        loads=replace(
            trial.loads, reactions=replace(reactions, steps=steps, valid_legs=whole_legs)
        ),
    )


def spoilt(walk: TrialResult, *, loaded: bool, resting: bool, plate: bool = True) -> TrialResult:
    """The first right stride with frames in its stance that do not count."""
    time, cycle = walk.body.time, list_strides(walk.events)["r"][0]
    bad = (time >= cycle.start + 0.1) & (time < cycle.start + 0.2)
    reactions = walk.loads.reactions
    arrays = {name: getattr(reactions, name).copy() for name in ("valid_legs", "loaded", "resting")}
    arrays["valid_legs"][bad, 0] = False
    arrays["loaded"][bad, 0], arrays["resting"][bad, 0] = loaded, resting
    if not plate:
        arrays["loaded"][:, 0] = False
    moved = replace(reactions, **arrays, steps=reactions.steps if plate else reactions.steps[1:])
    return replace(walk, loads=replace(walk.loads, reactions=moved))


def test_every_reason_has_its_frames(walk: TrialResult) -> None:
    def used(trial: TrialResult) -> list[tuple[str, int, str, bool, str]]:
        return [(u.side, u.number, u.plate, u.whole, u.reason) for u in collect_stride_uses(trial)]

    whole = [("r", 1, "1", True, ""), ("r", 2, "1", True, ""), ("l", 1, "2", True, "")]
    assert used(walk) == whole, "all frames are valid"
    near_begin = list_strides(walk.events)["r"][0].start + 0.15 - walk.body.time[0] < 0.3
    on_two = spoilt(walk, loaded=True, resting=True)
    seat = replace(on_two.loads.reactions, seated=~on_two.loads.reactions.valid_legs[:, 0])
    for trial, plate, reason in (
        (on_two, "1", stride_uses.NOT_WHOLLY),
        (replace(on_two, loads=replace(on_two.loads, reactions=seat)), "1", stride_uses.SEATED),
        (spoilt(walk, loaded=False, resting=True), "1", stride_uses.PART),
        (spoilt(walk, loaded=False, resting=True, plate=False), "", stride_uses.BESIDE),
        (
            spoilt(walk, loaded=False, resting=False),
            "1",
            stride_uses.ENDS if near_begin else stride_uses.UNSEEN,
        ),
        (replace(walk, loads=None), "", stride_uses.NO_PLATES),
        (replace(walk, refused_legs=("r",)), "1", stride_uses.REFUSED),
    ):
        assert used(trial)[0] == ("r", 1, plate, False, reason)
    assert used(on_two)[1:] == whole[1:], "the other strides stay"


def test_strides_that_count_are_told_in_a_sentence(walk: TrialResult) -> None:
    uses, counted = (
        collect_stride_uses(walk),
        "Usable for moments: 2 of 2 right, 1 of 1 left strides",
    )
    assert summarise_usable_strides(uses) == f"{counted}."
    mixed = [replace(use, repeats=use.number == 2) for use in uses]
    assert summarise_usable_strides(mixed) == f"{counted} and repetitions."
    told = summarise_usable_strides(collect_stride_uses(spoilt(walk, loaded=True, resting=True)))
    assert told == f"{counted.replace('2 of 2', '1 of 2')}; others: {stride_uses.NOT_WHOLLY}."


TRUE, FITTED, NOMINAL = 60.0, 58.0, 59.0
"""mm, of the right hip's place forward."""


def with_truth(calibration: Calibration) -> Calibration:
    wave, all_frames = np.sin(np.linspace(0.0, 6.0, FRAMES)), np.ones(FRAMES, dtype=bool)
    curve = CurveTruth(
        name="hip_flexion_r", truth=wave, fitted=wave + 2.0, nominal=wave - 1.0,
        error_bar=2.0 * all_frames,
        counts=all_frames,
    )  # fmt: skip
    hip = ParameterTruth(
        name="hip_r.pelvis.ant", kind="joint position", unit="mm", truth=TRUE, nominal=NOMINAL,
        fitted=FITTED,
        error_bar=2.0, status="fitted",
    )  # fmt: skip
    centre = FeatureTruth(
        joint="hip_r", part="centre", label="Hip centre in the pelvis", unit="mm", nominal=5.0,
        fitted=2.0,
        within=(True, True, False),
    )  # fmt: skip
    curves = CurveTruths(np.arange(FRAMES) / 100.0, {curve.name: curve}, {curve.name: curve})
    truth = TruthErrors(parameters=(hip,), features=(centre,), trials={"walk": curves})
    return replace(calibration, truth=truth)


@pytest.fixture(scope="module")
def blocks() -> list[Block]:
    return build_result_sections(with_truth(fake_calibration()))["joints"]


def test_sums_joints_angles_and_moments_are_told(blocks: list[Block]) -> None:
    assert "How near the truth" in headings(blocks)
    sums = rows_of(tables(blocks, "RMS error")[0])
    assert sums["joint positions, legs mm"] == ["1", "1.00", "farther: 2.00", "100 %"]
    assert sums["walk: leg angles deg"] == ["1", "1.00", "farther: 2.00", "100 %"]
    joints = rows_of(tables(blocks, "Centre or axis")[0])
    assert joints["Hip centre in the pelvis, mm"] == ["5.0", "2.0", "2 of 3", "–", "–", "–"]
    for head in ("Angle, deg", "Moment, N·m"):
        assert rows_of(tables(blocks, head)[0])["Hip flexion"][:3] == [
            "1.0",
            "farther: 2.0",
            "100 %",
        ]
    assert f"RMS error over all {FRAMES} frames" in words(blocks)


def test_the_truth_stands_beside_each_parameter(blocks: list[Block]) -> None:
    known = [
        row
        for b in walked(blocks)
        if b["kind"] == "intervals"
        for row in b["rows"]
        if row["truth"] is not None
    ]
    assert [(row["label"], row["side"], row["truth"]) for row in known] == [
        ("hip centre, pelvis, forward", "r", TRUE)
    ]
    (table,) = (b for b in tables(blocks, "Right") if "Truth" in b["head"])
    assert rows_of(table)["hip centre in the pelvis, forward mm"][-1] == format_number(TRUE)


def test_without_truth_nothing_of_it_is_there() -> None:
    assert (
        "truth"
        not in words(
            [b for s in build_result_sections(fake_calibration()).values() for b in s]
        ).lower()
    )
