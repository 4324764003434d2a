"""Member `people`: what it counts and compares, on people who are known, and small runs of each
part.
"""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gaitcal.calibration.error_sources import make_nominal_errors
from gaitcal.model.nominal import published_model
from gaitcal.model.parameters import JP_INDEX, JP_NAMES
from scripts.validation.harness import results
from scripts.validation.people import check, knees, simulated
from scripts.validation.people.fits import Fit
from scripts.validation.truth import skin
from tests.synthetic_studies import write_synthetic_study
from tests.validation.test_truth import TRACKING, _bending, simulated_trials

EXACT_MM = 1.0
"""Markers without noise, of which each half tells the hips."""
CLEAN_MM = 0.5
"""What hips of simulated people may be off without noise."""


def _fit(name: str, outward: float, error: float = 0.002) -> Fit:
    """A person whose hips moved outward in the pelvis by so many m."""
    nominal = published_model()
    joint = nominal.parameters.joint.copy()
    joint[JP_INDEX["hip_r.pelvis.lat"]] += outward
    joint[JP_INDEX["hip_l.pelvis.lat"]] -= outward
    for name_of in (f"hip_{side}.pelvis.{d}" for side in "rl" for d in ("ant", "sup")):
        joint[JP_INDEX[name_of]] += 1e-6
    return Fit(
        name=name,
        nominal=nominal,
        parameters=replace(nominal.parameters, joint=joint),
        errors=np.full(len(JP_NAMES), error),
        influence=make_nominal_errors(),
    )


def test_two_fits_differ_in_standard_errors_of_the_difference() -> None:
    one, other = _fit("a", 0.010), _fit("a", 0.016, 0.004)
    gap, score = check.gap_scores(one, other)
    assert (
        gap[0, 2] == gap[2, 2] == pytest.approx(6.0)
    )  # right and left in the pelvis; thighs moved nowhere
    assert check.largest(one, other)[0] == pytest.approx(6.0 / np.hypot(2.0, 4.0))
    assert np.isnan(score[1]).all()


@pytest.mark.slow
def test_hips_of_a_person_without_noise_agree(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    study, figures = write_synthetic_study(tmp_path, ("hip_r",)), tmp_path / "figures.json"
    arguments = ["--parts", "halves", "--study", str(study), "--json", str(figures)]
    found = results("people", *arguments)["halves"]
    far = [found[f"{study}, {words}: farthest, mm"] for words in ("as told", "no hip prior")]
    assert max(far) < EXACT_MM
    assert json.loads(figures.read_text(encoding="utf-8"))["halves"] == found
    assert "hip_r in pelvis" in capsys.readouterr().out


def test_hips_of_ct_miss_the_regression_as_published(data_dir: Path) -> None:
    images = check.imaged(data_dir / "imaging")
    assert images.errors.shape == (39, 3)
    np.testing.assert_allclose(images.errors.std(axis=0, ddof=1), [6.5, 6.9, 7.0], atol=0.05)
    assert np.abs(images.errors.mean(axis=0)).max() < 2.4
    assert (round(images.ratios.min(), 2), round(images.ratios.max(), 2)) == (0.65, 0.82)
    near, far = _fit("near", 0.002), _fit("far", 0.040)
    assert check.outside([near, far], images) == {
        "hips": 4.0,
        "hips outside": 2.0,
        "pairs outside": 1.0,
    }


def test_a_marker_of_the_thigh_turns_about_the_hinge() -> None:
    """Forward and up in the shank, mm, of a point 20 above and 5 behind a hinge that lies 18 below
    the origin.
    """
    flexion = np.linspace(0.0, 1.0, 40)
    turn = np.array([[np.cos(flexion), -np.sin(flexion)], [np.sin(flexion), np.cos(flexion)]])
    path = np.array([3.0, -18.0]) + np.einsum("ijf,j->fi", turn, [-5.0, 20.0])
    assert path[-1, 0] < path[0, 0], "a thigh that bends takes what is above the hinge backwards"
    centre, misfit = knees.circle(flexion, path)
    np.testing.assert_allclose(centre, [3.0, -18.0], atol=1e-9)
    assert misfit < 1e-9 < knees.circle(flexion, path + [[0.0, 1.0], [0.0, -1.0]] * 20)[1]


def test_skin_of_people_has_the_size_of_its_task() -> None:
    angles = 40.0 * np.sin(np.arange(200) * 0.05)
    recording, rest = _bending(angles)
    sizes = []
    for seed in range(60):
        walk, again, task = (
            skin.displacement(recording, rest, TRACKING, skin.Kind.PEOPLE, 15.0, (seed, trial), of)
            for trial, of in ((1, "walk"), (2, "walk"), (3, "hip_r"))
        )
        np.testing.assert_array_equal(walk, again)
        assert not np.allclose(walk, task)
        sizes.append(walk)
    at = [recording.labels.index(label) for label in TRACKING["pelvis"]]
    middle = np.array(sizes)[:, :, at].mean(axis=2)
    np.testing.assert_allclose(middle.mean(axis=1), 0.0, atol=1e-12)  # about the task's own middle
    rms = 1e3 * np.sqrt((middle**2).mean())  # one hip flexes, and all else stands
    assert rms == pytest.approx(np.hypot(2.0, 0.7 / np.sqrt(3)), rel=0.1)
    restless = [
        skin.displacement(recording, rest, TRACKING, skin.Kind.RESTLESS, 15.0, (1, k), "walk")
        for k in (1, 2)
    ]
    assert not np.allclose(*restless)


def test_joints_of_a_real_person(data_dir: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found = results("people", "--parts", "hips", "--only", "one_frame")["hips"]
    assert found["all: RMS 3-D"] > 0.0 and found["hips"] == 2.0
    assert "hip.thigh.lat" in capsys.readouterr().out


@pytest.mark.slow
@pytest.mark.peers
def test_hips_of_a_simulated_person(data_dir: Path, kept: Path) -> None:
    cache = simulated_trials(kept, data_dir)
    out: dict[str, float] = {}
    for kind in (skin.Kind.NONE, skin.Kind.PEOPLE):
        rows: simulated.Rows = {}
        simulated.add_fits(rows, "p01", kind, 0, {}, cache, drawn=False)
        assert (
            len(list(simulated.lines(simulated.hips_in_space(rows), out, f"{kind.value}, "))) == 4
        )
    # without noise the artefact is a fiftieth of people's, and not nothing: the prior on its size
    # sees to that
    exact, moved = (out[f"{kind}, isolated: hip in space, mm: RMS"] for kind in ("none", "people"))
    assert exact < CLEAN_MM < moved < 60.0
