"""`python -m scripts.validation attacks`: its own measures, and the few attacks that run
as a test.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from scripts.validation.attacks import check
from scripts.validation.attacks.check import Ending, Result
from scripts.validation.attacks.corpus import Attack, CorpusError, Kind, corpus, once_each, spoilt
from scripts.validation.harness import results

FEWEST = 150
"""Attacks of a run without options."""


def test_the_corpus_is_broad_and_every_title_unique() -> None:
    every = corpus()
    chosen = list(once_each(every))
    assert len(chosen) >= FEWEST
    assert {a.kind for a in chosen} == set(Kind)
    assert len({a.base for a in chosen}) == len({a.base for a in every}) == 10
    assert len({a.title for a in every}) == len(every)


def test_another_number_is_no_new_message() -> None:
    clean = ["walk: residual 17.3 N, limit 9.5 N"]
    assert check.new(["walk: residual 21 N, limit -9.5e3 N"], clean) == ()
    assert check.new(["walk: residual 21 N; R.Heel left its place"], clean) != ()


def test_all_words_must_stand_in_one_message_and_a_list_of_all_causes_names_none() -> None:
    assert check.names_cause("walk: R.Heel left its place", (r"R\.Heel", "place"))
    assert not check.names_cause("walk: L.Heel left its place", (r"R\.Heel", "place"))
    assert not check.names_cause(
        "disagree; look at plate positions, force sign and clock, mass_kg", ("clock",)
    )


def _curves(count: int = 50) -> check.Curves:
    rng = np.random.default_rng(1)
    markers = rng.normal(size=(count, 4, 3))
    point, axis = rng.normal(size=(count, 3)), np.tile([0.0, 0.0, 1.0], (count, 1))
    return check.Curves(
        time=np.arange(count) * 0.01,
        labels=("a", "b", "c", "d"),
        markers=markers,
        angles=np.zeros((count, 12)),
        angle_bars=np.full((count, 12), 0.1),
        torques=np.zeros((count, 14)),
        torque_bars=np.full((count, 14), 4.0),
        valid=np.arange(count) >= 10,
        centres={"hip_r": (point, axis), "knee_r": (point, axis)},
        centre_bars={"hip_r": 0.01, "knee_r": 0.01},
    )


def test_movement_is_told_in_error_bars_of_the_run_itself() -> None:
    clean = _curves()

    def moved(**changes: object) -> check.Movement:
        found = check.largest({"walk": replace(clean, **changes)}, {"walk": clean})  # type: ignore[arg-type]
        assert found is not None
        return found

    assert moved().bars == pytest.approx(0.0, abs=1e-9)
    torques = np.zeros((50, 14))
    torques[:10, 3] = 1e3  # frames that are not valid
    torques[10:, 13] = 12.0
    found = moved(torques=torques)
    assert found.bars == pytest.approx(3.0)
    assert "knee_adduction_l" in found.words
    assert moved(angles=np.full((50, 12), -0.05)).bars == pytest.approx(0.5)
    point, axis = clean.centres["hip_r"]
    beside = {"hip_r": (point, axis), "knee_r": (point + [0.0, 0.0, 0.5], axis)}
    assert moved(centres=beside).bars == pytest.approx(0.0, abs=1e-9)  # along its axis
    off = {"hip_r": (point + [0.0, 0.0, 0.02], axis), "knee_r": (point, axis)}
    assert moved(centres=off).bars == pytest.approx(2.0)


def test_a_laboratory_turned_as_a_whole_moves_nothing() -> None:
    clean = _curves()
    turn, shift = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]]), np.array([1.0, 0.0, 2.0])
    centres = {
        name: (point @ turn.T + shift, axis @ turn.T)
        for name, (point, axis) in clean.centres.items()
    }
    found = check.largest(
        {"walk": replace(clean, markers=clean.markers @ turn.T + shift, centres=centres)},
        {"walk": clean},
    )
    assert found is not None
    assert found.bars < 1e-6


def test_limits_of_the_shares() -> None:
    def results(**counts: int) -> list[Result]:
        return [
            Result(attack=f"{ending} {i}", kind=Kind.WALK, ending=Ending(ending))
            for ending, count in counts.items()
            for i in range(count)
        ]

    assert check.passed(results(named=88, silent=2, alarmed=10))
    assert not check.passed(results(named=87, silent=3, alarmed=10))
    assert not check.passed(results(named=87, silent=2, alarmed=11))
    assert not check.passed(results(named=99, crash=1))


@pytest.mark.slow
def test_an_attack_that_cannot_be_made_is_a_fault_of_the_corpus(tmp_path: Path) -> None:
    broken = Attack(
        name="x",
        base="synthetic",
        kind=Kind.WALK,
        where="walk",
        how="frozen no_such_marker 0.4,0.6",
        named=(),
    )
    with pytest.raises(CorpusError, match="itself failed"):
        spoilt(broken, tmp_path)


@pytest.mark.slow
def test_nothing_of_the_quick_part_goes_unnoticed(
    data_dir: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = results("attacks", "--quick", "--json", str(tmp_path / "results.json"))
    assert len(found) >= 12
    put_back = {r.attack for r in found if r.ending is Ending.HARMLESS}
    assert put_back == {
        "subject01: markers of the walk: thigh_r cluster mirrored",
        "subject01: markers of the walk: two thigh labels exchanged in a quarter",
    }
    bad = [r for r in found if r.ending not in (Ending.REFUSED, Ending.NAMED, Ending.HARMLESS)]
    assert not bad, "\n".join(check.lines(bad))
    assert "refused" in capsys.readouterr().out
    assert (tmp_path / "results.json").stat().st_size > 0
