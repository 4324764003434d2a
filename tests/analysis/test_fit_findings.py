"""What is said against a finished calibration: when, with which numbers, and with which cure."""

from dataclasses import replace

from gaitcal.analysis.fit_findings import check_convergence, check_marker_fit
from gaitcal.analysis.result import Calibration
from gaitcal.errors import Code, Severity
from tests.fake_result import with_phase
from tests.messages import check_finding


def test_a_trial_that_is_met_worse_is_told(whole: Calibration) -> None:
    knee = whole.trial("knee")
    errors = replace(knee.final.errors, distance=3.0 * knee.final.errors.distance)
    worse = replace(knee, final=replace(knee.final, errors=errors))
    assert list(check_marker_fit([knee])) == []
    (finding,) = check_marker_fit([worse])
    assert (finding.where, finding.severity) == ("knee", Severity.WARNING)
    check_finding(finding, Code.TRIALS_DISAGREE)


def test_a_fit_that_stopped_early_is_told(whole: Calibration) -> None:
    assert list(check_convergence(whole.phases)) == []
    findings = list(check_convergence(with_phase(whole, converged=False).phases))
    assert [f.cause for f in findings] == [
        f"the fit of {phase.name} did not converge" for phase in whole.phases
    ]
