"""From findings to a verdict: overall, for each walk and leg, one reason a cause, the
worst first.
"""

from dataclasses import replace
from itertools import permutations
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gaitcal.errors import STUDY, Code, Finding, Severity
from gaitcal.quality.verdict import (
    BOUNDS,
    FORCES,
    JOINT_POSITIONS,
    MARKERS_AFTER_FIT,
    SPOILS,
    Judgement,
    Verdict,
    collect_reasons,
    judge,
    remove_consequences,
    select_stopping_errors,
)
from tests.messages import check_text, numbers

GOOD, DOUBTFUL, REFUSED = Judgement
WALKS = ("walk", "walk2")
JUDGED = {Severity.INFO: GOOD, Severity.WARNING: DOUBTFUL, Severity.ERROR: REFUSED}


def found(
    severity: Severity,
    where: str,
    cause: str = "a",
    leg: str = "",
    weight: float = 1.0,
    **more: Any,
) -> Finding:
    kind = {"code": Code.CLOCKS_DIFFER, "topic": FORCES, "found": "3 mm", "cure": "do", **more}
    return Finding(severity=severity, where=where, cause=cause, leg=leg, weight=weight, **kind)


def both_legs(where: str) -> list[Finding]:
    return [found(Severity.ERROR, where, cause, leg) for cause, leg in (("a", "l"), ("b", "r"))]


def legs_of(verdict: Verdict) -> dict[tuple[str, str], Judgement]:
    return {
        (walk, side): j for walk, trial in verdict.trials.items() for side, j in trial.legs.items()
    }


def test_nothing_found_is_trustworthy() -> None:
    verdict = judge([], WALKS)
    assert (
        verdict.judgement is GOOD
        and set(legs_of(verdict).values()) == {GOOD}
        and verdict.reasons == ()
    )


@pytest.mark.parametrize("severity", Severity)
def test_what_concerns_the_model_concerns_every_walk(severity: Severity) -> None:
    for where in (STUDY, "static", "hip_r"):
        verdict = judge([found(severity, where)], WALKS)
        assert verdict.judgement is JUDGED[severity]
        assert set(legs_of(verdict).values()) == {JUDGED[severity]}


@pytest.mark.parametrize("severity", Severity)
def test_what_concerns_one_walk_leaves_the_other_alone(severity: Severity) -> None:
    verdict = judge([found(severity, "walk")], WALKS)
    assert [verdict.trials[walk].judgement for walk in WALKS] == [JUDGED[severity], GOOD]
    assert verdict.judgement is (GOOD if severity is Severity.INFO else DOUBTFUL)
    assert judge([found(severity, "walk")], ("walk",)).judgement is JUDGED[severity]


def test_what_concerns_one_leg_leaves_the_other_alone() -> None:
    verdict = judge([found(Severity.ERROR, "walk", leg="l")], WALKS)
    assert legs_of(verdict) == {
        ("walk", "r"): GOOD,
        ("walk", "l"): REFUSED,
        ("walk2", "r"): GOOD,
        ("walk2", "l"): GOOD,
    }
    assert verdict.trials["walk"].judgement is DOUBTFUL and verdict.refused == ()
    assert verdict.list_refused_legs("walk") == ("l",) and verdict.list_refused_legs("walk2") == ()
    assert verdict.judgement is DOUBTFUL
    check_text(verdict.sentence)
    both = judge(both_legs("walk"), WALKS)
    assert (
        both.refused == ("walk",)
        and both.judgement is DOUBTFUL
        and both.list_refused_legs("walk") == ("r", "l")
    )
    assert judge(both_legs("walk"), ("walk",)).judgement is REFUSED
    of_the_model = judge([found(Severity.ERROR, "static", leg="l")], WALKS)
    assert of_the_model.judgement is DOUBTFUL
    assert {leg for leg, j in legs_of(of_the_model).items() if j is REFUSED} == {
        ("walk", "l"),
        ("walk2", "l"),
    }
    assert judge([found(Severity.ERROR, "static", leg="l")], ()).judgement is REFUSED


FINDINGS = st.builds(
    found,
    st.sampled_from(Severity),
    st.sampled_from([STUDY, "static", *WALKS]),
    st.sampled_from("abc"),
    st.sampled_from(["", "r", "l"]),
    st.floats(0.1, 10.0),
)


@given(st.lists(FINDINGS, max_size=6))
def test_more_findings_never_improve_the_verdict(findings: list[Finding]) -> None:
    order = list(Judgement)
    before = judge(findings[:-1], WALKS)
    after = judge(findings, WALKS)
    assert order.index(after.judgement) >= order.index(before.judgement)
    for leg, judgement in legs_of(after).items():
        assert order.index(judgement) >= order.index(legs_of(before)[leg])
    said = [f for f in findings if f.severity is not Severity.INFO]
    assert (after.judgement is GOOD) == (not said)


@given(st.lists(FINDINGS, min_size=1, max_size=5))
def test_one_reason_a_cause_the_worst_first(findings: list[Finding]) -> None:
    reported = collect_reasons(findings)
    said = [f for f in findings if f.severity is not Severity.INFO]
    assert sorted(r.cause for r in reported) == sorted({f.cause for f in said})
    order = list(Severity)
    assert [order.index(r.severity) for r in reported] == sorted(
        order.index(r.severity) for r in reported
    )
    for reason in reported:
        own = [f for f in said if f.cause == reason.cause]
        assert reason.severity is min((f.severity for f in own), key=order.index)
        assert set(reason.trials) == {f.where for f in own} - {STUDY}


def test_worst_of_one_severity_is_first() -> None:
    some = [
        found(Severity.WARNING, "walk", cause, weight=weight)
        for cause, weight in (("a", 1), ("b", 9), ("c", 4))
    ]
    for order in permutations(some):
        assert [r.cause for r in collect_reasons(order)] == ["b", "c", "a"]


def test_findings_without_a_cause_are_one_where_only_their_numbers_differ() -> None:
    def plain(where: str, text: str) -> Finding:
        return Finding(
            code=Code.GAPS,
            severity=Severity.WARNING,
            topic="gaps",
            where=where,
            found=text,
            cure="fill",
        )

    (reported,) = collect_reasons(
        [plain("a", "no marker for 0.3 s"), plain("b", "no marker for 0.51 s")]
    )
    assert reported.trials == ("a", "b")
    assert numbers(reported.line) == [0.3, 0.51] and reported.line.startswith("a, b: gaps: ")
    assert (
        len(collect_reasons([plain("a", "no marker for 0.3 s"), plain("b", "no force for 0.3 s")]))
        == 2
    )


CONTRADICTED = found(
    Severity.WARNING, "walk", "contradicts the body's acceleration", code=Code.FORCES_CONTRADICT
)
DISAGREE = found(Severity.ERROR, "walk", topic=BOUNDS, code=Code.FORCES_OF_ANOTHER)


def test_consequences_of_a_named_fault_are_removed() -> None:
    late, everywhere = (
        found(Severity.WARNING, where, "the forces come late") for where in ("walk", STUDY)
    )
    off = found(Severity.WARNING, "walk", "marker 'R.Heel' is odd", topic=MARKERS_AFTER_FIT)
    assert remove_consequences([CONTRADICTED, off]) == (CONTRADICTED, off)
    assert remove_consequences([CONTRADICTED, late]) == (late,)
    assert remove_consequences([CONTRADICTED, everywhere]) == (everywhere,)
    assert remove_consequences([CONTRADICTED, replace(late, where="walk2")])[0] == CONTRADICTED
    before = found(Severity.WARNING, "walk", "marker 'R.Heel' left its place", topic="clusters")
    assert remove_consequences([before, off]) == (before,)
    for other in (
        {"where": "hip_r"},
        {"severity": Severity.INFO},
        {"cause": "marker 'L.Heel' left its place"},
    ):
        assert remove_consequences([replace(before, **other), off])[-1] == off  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("topic", "spoilt"), [(topic, spoilt) for topic in SPOILS for spoilt in SPOILS[topic]]
)
def test_consequences_of_a_disordered_trial_are_removed(topic: str, spoilt: str) -> None:
    cause = found(Severity.ERROR, "walk", topic=topic)
    effect = found(Severity.WARNING, "walk", "b", topic=spoilt)
    assert remove_consequences([effect, cause]) == (cause,)
    for other in (
        replace(cause, where="walk2"),
        replace(cause, severity=Severity.WARNING),
        replace(cause, cause=""),
    ):
        assert remove_consequences([effect, other]) == (effect, other)


@pytest.mark.parametrize("where", ["walk", STUDY])
def test_explained_residual_is_removed(where: str) -> None:
    residual = found(
        Severity.WARNING, "walk", "motion and forces disagree", code=Code.UNEXPLAINED_RESIDUAL
    )
    late = found(Severity.WARNING, where, "the forces come late")
    assert remove_consequences([residual]) == (residual,)
    assert remove_consequences([late, residual]) == (late,)
    assert remove_consequences([replace(late, where="walk2"), residual])[1:] == (residual,)
    off = replace(DISAGREE, where=where)
    assert remove_consequences([off, residual]) == (off,)


def test_marker_faults_make_other_walks_doubtful_and_force_faults_do_not() -> None:
    markers = found(Severity.ERROR, "walk", topic="clusters")
    forces, doubt = found(Severity.ERROR, "walk"), replace(markers, severity=Severity.WARNING)
    for said, other in ((markers, DOUBTFUL), (forces, GOOD), (doubt, GOOD)):
        assert judge([said], WALKS).trials["walk2"].judgement is other
    assert judge([replace(markers, leg="l")], WALKS).trials["walk"].legs == {
        "r": GOOD,
        "l": REFUSED,
    }


def test_errors_stop_only_if_a_walk_keeps_no_leg() -> None:
    """One leg without its toe: the other is computed. A warning never stops, an error without a leg
    always does.
    """
    left, right = both_legs("walk")
    assert (
        select_stopping_errors([left], WALKS)
        == ()
        == select_stopping_errors([replace(left, where="walk2"), right], WALKS)
    )
    assert select_stopping_errors([replace(left, where="static")], WALKS) == ()
    assert select_stopping_errors([left, right], WALKS) == (left, right)
    assert select_stopping_errors([replace(left, where="ankle_l"), right], WALKS) == (
        replace(left, where="ankle_l"),
        right,
    )
    for where in (*WALKS, "static", STUDY):
        assert select_stopping_errors([found(Severity.WARNING, where)], WALKS) == ()
        assert len(select_stopping_errors([found(Severity.ERROR, where)], WALKS)) == 1
    assert select_stopping_errors([left], ()) == (left,)


def test_undetermined_leg_explains_later_findings() -> None:
    lost = found(Severity.ERROR, "walk", "one marker alone follows foot_l", "l", topic="one marker")
    bounds = found(Severity.ERROR, "walk", "no leg bends so", "l", topic=BOUNDS)
    assert remove_consequences([lost, bounds, DISAGREE, CONTRADICTED]) == (lost,)
    assert judge(remove_consequences([lost, DISAGREE]), ("walk",)).list_refused_legs("walk") == (
        "l",
    )
    for elsewhere in (
        replace(bounds, leg="r"),
        replace(bounds, where="walk2"),
        replace(DISAGREE, where="walk2"),
    ):
        assert remove_consequences([lost, elsewhere]) == (lost, elsewhere)
    doubt = replace(lost, severity=Severity.WARNING)
    assert remove_consequences([doubt, bounds, DISAGREE]) == (doubt, bounds, DISAGREE)


def test_unusual_joint_position_gives_one_finding() -> None:
    cause = "the right hip joint lies where fewer than 1 in 1000 people have one"
    place = found(Severity.WARNING, STUDY, cause, "r", topic=JOINT_POSITIONS, code=Code.JOINT_PLACE)
    words = "is further from its position in the static trial than in people"
    hip, knee = (
        replace(place, topic="a", code=Code.JOINT_AT_BOUND, cause=f"{j} {words}")
        for j in ("hip_r", "knee_r")
    )
    assert remove_consequences([hip, place, knee]) == (place, knee)
    another = replace(hip, code=Code.OTHER_BODY, severity=Severity.ERROR)
    assert remove_consequences([place, another]) == (another,)
