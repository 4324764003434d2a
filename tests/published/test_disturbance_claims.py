"""Claims on disturbed models: not run without draws; verdicts follow the figures, each frame by itself."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pandas as pd
import pytest

from gaitcal.published import reproduce
from gaitcal.published.claims import Claim, Verdict
from gaitcal.published.disturbance_claims import Disturbances, disturbance_claims
from gaitcal.published.draw import TORQUES
from gaitcal.published.protocol import PUBLISHED_LEVELS, MonteCarloSettings, Plan, ReactionFrame, Varied
from gaitcal.published.reproduce import ReproductionSettings, _disturb

AS_PUBLISHED = dict(zip(TORQUES, (4.14, 1.06, 0.7, 0.92, 0.95, 0.50, 0.55), strict=True))
"""%BW*H: JP errors at 100 % that would make every claim hold."""


def disturbed_table(
    jp: dict[str, float] | None = None, ip: float = 0.05, noise: float = 0.2, settles: float = 1.0, jp_mm: float = 28.0
) -> pd.DataFrame:
    rows = []
    jp = jp or AS_PUBLISHED
    for varied in Varied:
        for level in PUBLISHED_LEVELS:
            for torque in TORQUES:
                whole = {Varied.JP: jp[torque], Varied.IP: ip, Varied.NOISE: noise, Varied.BOTH: jp[torque]}[varied]
                for frame in ReactionFrame:
                    for measure, factor in (("rms", 1.0), ("mean", 0.1), ("abs_mean", 0.3)):
                        value = whole * factor * level / 100
                        rows.append((varied.value, level, f"{torque}_l", frame.value, measure, value))
            distance = {Varied.JP: jp_mm, Varied.BOTH: jp_mm, Varied.IP: 0.0, Varied.NOISE: 7.0}[varied] * level / 100
            rows += [(varied.value, level, "markers_l", "", m, distance * f) for m, f in (("rms", 1.0), ("mean", 0.93))]
    table = pd.DataFrame(rows, columns=["set", "level", "quantity", "grf", "measure", "average"])
    extra = dict.fromkeys(("p10", "p50", "p90"), table["average"])
    return table.assign(mean_settles=settles, cv_settles=settles, **extra)


def _wide(torque: str = "hip_flexion") -> pd.DataFrame:
    table = disturbed_table(ip=0.1)
    worst = (table["set"] == "ip") & (table["quantity"] == f"{torque}_l")
    table.loc[worst, "average"] *= 3.1
    return table[table["set"] == "ip"]


def _of(claims: list[Claim], words: str) -> set[Verdict]:
    found = {c.verdict for c in claims if words in c.claim}
    assert found, words
    return found


def test_not_run_without_draws() -> None:
    claims = disturbance_claims(None)
    assert {c.verdict for c in claims} == {Verdict.NOT_RUN}
    assert len({c.claim for c in claims}) == len(claims) > 20


def test_published_figures_make_every_claim_hold() -> None:
    claims = disturbance_claims(Disturbances(disturbed_table(), _wide(), 5000))
    assert [c.claim for c in claims if c.verdict is not Verdict.HOLDS and "small mean" not in c.claim] == []
    assert [c.claim for c in claims] == [c.claim for c in disturbance_claims(None)]


@pytest.mark.parametrize(
    ("words", "table", "wide"),
    [
        ("disturb every torque more", disturbed_table(ip=0.6), _wide()),
        ("every torque error is small", disturbed_table(ip=0.3), _wide()),
        ("hip flexion is worst", disturbed_table(), _wide("knee_angle")),
        ("small in torques", disturbed_table(noise=1.2), _wide()),
        ("JP: hip flexion error", disturbed_table({**AS_PUBLISHED, "hip_flexion": 3.0}), _wide()),
        ("knee flexion errors together", disturbed_table({**AS_PUBLISHED, "knee_angle": 1.3}), _wide()),
        ("hip flexion is largest", disturbed_table({**AS_PUBLISHED, "hip_rotation": 2.0}), _wide()),
        ("distal to proximal", disturbed_table({**AS_PUBLISHED, "ankle_angle": 2.0}), _wide()),
        ("inversion slightly above", disturbed_table({**AS_PUBLISHED, "subtalar_angle": 0.4}), _wide()),
        ("14 mm of marker error", disturbed_table(jp_mm=20.0), _wide()),
        ("4 mm of marker error", disturbed_table(jp_mm=10.0), _wide()),
    ],
)
def test_other_figures_do_not(words: str, table: pd.DataFrame, wide: pd.DataFrame) -> None:
    assert _of(disturbance_claims(Disturbances(table, wide, 5000)), words) == {Verdict.FAILS}


def test_frames_are_judged_apart() -> None:
    table = disturbed_table()
    foot = (table["grf"] == "foot") & (table["set"] == "jp") & (table["quantity"] == "hip_flexion_l")
    table.loc[foot, "average"] = 1.0
    claims = [c for c in disturbance_claims(Disturbances(table, _wide(), 5000)) if "JP: hip flexion error" in c.claim]
    assert [(c.verdict, "foot" in c.claim) for c in claims] == [(Verdict.HOLDS, False), (Verdict.FAILS, True)]


def test_too_few_draws_do_not_refute_convergence() -> None:
    for draws, expected in ((500, Verdict.NOT_RUN), (5000, Verdict.FAILS)):
        found = disturbance_claims(Disturbances(disturbed_table(settles=3.0), _wide(), draws))
        assert _of(found, "settle within 2 %") == {expected}


def test_the_four_sets_have_the_published_bounds_and_inertial_parameters_alone_wider_ones(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[tuple[object, ...]] = []

    def study(case: object, folder: Path | None, **options: Any) -> SimpleNamespace:
        asked.append((folder, options["settings"], options["plan"]))
        return SimpleNamespace(statistics=len(asked))

    monkeypatch.setattr(reproduce, "monte_carlo", study)
    assert _disturb(ReproductionSettings(seed=3, draws=7), Path("kept"), lambda _: None) == Disturbances(1, 2, 7)
    assert asked == [
        (Path("kept/published"), MonteCarloSettings(seed=3), Plan(draws=7)),
        (Path("kept/inertial50"), MonteCarloSettings(seed=3, inertial_percent=50.0), Plan((Varied.IP,), (100,), 7)),
    ]
