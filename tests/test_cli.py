"""The command line as a user meets it, and what the README says of it."""

import importlib
import json
from functools import partial
from importlib.metadata import version
from pathlib import Path

import pandas as pd
import pytest
from typer.testing import CliRunner

from gaitcal.cli.application import app
from gaitcal.model.coordinates import LEG_COORDINATES
from gaitcal.model.parameters import IP_NAMES, JP_NAMES
from gaitcal.study.settings import CalibrationSettings
from tests.commands import gaitcal
from tests.kept import copied_person
from tests.messages import check_text

ROOT = Path(__file__).parents[1]
ORDER = (
    "demo", "example", "init", "check", "calibrate", "cohort", "dynamics", "convert", "synthesize",
    "montecarlo", "reproduce", "export", "figures", "view", "report",
)  # fmt: skip
FILES = (
    "summary.json", "parameters.csv", "model.toml", "model.osim", "model.urdf", "model.xml",
    "motion/walk.mot", "motion/walk.csv", "moments/walk.sto", "moments/walk.csv",
    "marker_errors/walk.csv", "result.html", "page.json", "scene.npz", "manifest.json",
)  # fmt: skip


def test_help_shows_the_commands_in_order() -> None:
    text = CliRunner().invoke(app, ["--help"]).output
    places = [text.index(f"\n  {name}") for name in ORDER]
    assert places == sorted(places)
    assert "..." not in text.partition("Commands:")[2], "the first sentence of each help text fits"


def test_the_version_is_told() -> None:
    told = CliRunner().invoke(app, ["--version"])
    assert (told.exit_code, told.output) == (0, f"gaitcal {version('gaitcal')}\n")


@pytest.mark.parametrize(
    "words", [("montecarlo", ".", "--levels", "abc"), ("export", ".", "--format", "foo")]
)
def test_usage_errors_end_with_2(words: tuple[str, ...]) -> None:
    assert [gaitcal(word).returncode for word in ("calibrate", "no-such-command")] == [2, 2]
    done = gaitcal(*words)
    assert (done.returncode, len(done.stderr.splitlines())) == (2, 1)
    assert done.stderr.startswith(f"gaitcal: {words[2]}: found ")


def test_a_wrong_file_of_normal_bands_ends_with_1_before_anything_is_read(tmp_path: Path) -> None:
    bands = tmp_path / "normal.csv"
    bands.write_text("variable,unit,percent,mean,sd\nhip_flexion,deg,0,1,1\n", encoding="utf-8")
    done = gaitcal(
        "calibrate", "no-study.toml", "--out", str(tmp_path / "out"), "--normal", str(bands)
    )
    assert done.returncode == 1 and "normal.csv: signs: missing; allowed: " in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_the_reference_tells_every_command_and_setting() -> None:
    pages = [
        (ROOT / f"docs/reference/{name}.md").read_text(encoding="utf-8")
        for name in ("commands", "study-file")
    ]
    for name in (*ORDER, "compare"):
        assert f"## {name}\n\n{{{{ command: {name} }}}}\n" in pages[0], name
    assert "\n{{ table: calibration }}\n" in pages[1]
    settings = importlib.import_module("scripts.tools.documentation.tables").markdown("calibration")
    for name, field in CalibrationSettings.model_fields.items():
        row = next(line for line in settings.splitlines() if line.startswith(f"| `{name}` |"))
        assert row.endswith(f"| {field.description} |"), name


@pytest.mark.slow
def test_calibrate_dynamics_export_on_a_real_walk(data_dir: Path, tmp_path: Path) -> None:
    """Everything in DIR, a further trial with error bars, the model for other programs."""
    from tests.real_studies import write_study

    study, out = write_study("subject01", data_dir.resolve(), tmp_path), tmp_path / "result"
    done = gaitcal("calibrate", str(study), "--out", str(out))
    assert done.returncode == 0, done.stderr
    assert all((out / file).stat().st_size > 0 for file in FILES)
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert summary["status"] == "converged"
    assert summary["trials"]["walk"]["pelvis_and_legs_mm"]["calibrated"] < 6.0
    parameters = pd.read_csv(out / "parameters.csv")
    assert list(parameters.columns) == [
        *(
            "name",
            "kind",
            "segment",
            "joint",
            "unit",
            "nominal",
            "fitted",
            "standard_error",
            "status",
            "prior_mean",
            "prior_sd",
        )
    ]
    assert len(parameters) == len(JP_NAMES) + len(IP_NAMES)
    fitted = parameters[parameters["status"] == "fitted"]
    assert (fitted["standard_error"] > 0).all()
    moments = pd.read_csv(out / "moments/walk.csv", comment="#")
    assert {
        "time",
        "valid",
        "hip_flexion_r",
        "hip_flexion_r_se",
        "hip_flexion_r_bwh",
        "knee_adduction_l",
    } <= set(moments)

    walk = data_dir / "subject01/subject01_walk1.trc"
    forces = data_dir / "subject01/subject01_walk1_grf.mot"
    more = gaitcal("dynamics", str(out), str(walk), "--forces", str(forces))
    assert more.returncode == 0, more.stderr
    again = pd.read_csv(out / "dynamics/moments/subject01_walk1.csv", comment="#")
    valid = moments["valid"] == 1
    told = json.loads((out / "dynamics/summary.json").read_text(encoding="utf-8"))
    check_text(told["notes"])
    assert told["warnings"] == []
    gap = (again["knee_angle_r"] - moments["knee_angle_r"])[valid]
    assert gap.abs().max() < 1e-3

    assert gaitcal("export", str(out), "--format", "osim,urdf").returncode == 0
    assert (out / "export/model.osim").read_bytes() == (out / "model.osim").read_bytes()
    peer = gaitcal(
        "compare", str(out), "--osim", str(data_dir / "subject01/reference/subject01_simbody.osim")
    )
    assert "hip_r centre in pelvis" in peer.stdout


@pytest.mark.slow
def test_demo_recovers_its_subject(
    kept: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The person is one of those that other tests ask for, too."""
    person = partial(copied_person, kept, seed=3, noise=True, perturb=True)
    monkeypatch.setattr("gaitcal.synthetic.subject.synthesize", lambda out, **_: person(out))
    done = gaitcal("demo", "--out", str(tmp_path / "demo"))
    assert done.returncode == 0, done.stderr
    assert "result.html" in done.stdout and "…" not in done.stdout, "no word of a table is cut"
    assert (tmp_path / "demo/result/page.json").exists()
    assert (
        f"gait: leg moments against the truth (RMS over {2 * len(LEG_COORDINATES)})" in done.stdout
    )
    manifest = json.loads((tmp_path / "demo/result/manifest.json").read_text(encoding="utf-8"))
    assert "truth/gait_moments.csv" in manifest["files"], "what a result holds is in its manifest"
    assert "truth/gait_moments.csv" in manifest["inputs_sha256"], (
        "it is an input like the recordings"
    )
