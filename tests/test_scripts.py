"""The scripts are thin programs over the public API: examples, benchmark and the comparison of
results run.
"""

import importlib.util
import json
import re
import shutil
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest

import gaitcal as gc
from scripts.tools import compare_results
from scripts.tools.benchmark import __main__ as benchmark
from tests.kept import copied_person, kept_calibration

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "scripts" / "examples"


def example(name: str) -> ModuleType:
    """The program of that name: it begins with a digit, so that `import` cannot name it."""
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_benchmark_runs_a_section_and_writes_its_figures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "figures.json"
    benchmark.main(["ip", "inverse-dynamics", "--runs", "1", "--json", str(out)])
    figures = json.loads(out.read_text(encoding="utf-8"))
    assert figures["machine"]["blas_threads"] == 1
    assert all(
        f["seconds"] > 0
        for section in ("ip", "inverse-dynamics")
        for f in figures[section].values()
    )
    assert "physically consistent" in capsys.readouterr().out


@pytest.fixture
def once(kept: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The person of the first two scripts is one of which other tests ask, too."""
    monkeypatch.setattr(
        gc,
        "synthesize",
        lambda out, **_: copied_person(kept, out, seed=3, noise=True, perturb=True, whole=True),
    )
    calibration = kept_calibration(kept)  # by the true function, before its name is another's
    monkeypatch.setattr(gc, "calibrate", lambda *_: calibration)


@pytest.mark.slow
@pytest.mark.usefixtures("once")
def test_calibrate_script_writes_a_result_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    example("01_calibrate").main([str(tmp_path)])
    said = capsys.readouterr().out
    assert {"result.html", "page.json", "scene.npz", "model.osim"} <= {
        p.name for p in (tmp_path / "result").iterdir()
    }
    nominal, calibrated, floor = (
        float(word) for word in re.findall(r"^gait +(.*)$", said, re.M)[0].split()
    )
    assert floor < calibrated < nominal
    assert (tmp_path / "result" / "result.html").as_posix() in said


@pytest.mark.slow
@pytest.mark.usefixtures("once")
def test_uncertainty_script_sets_errors_beside_standard_errors(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    example("02_uncertainty").main([str(tmp_path)])
    said = capsys.readouterr().out
    within, of = map(
        int, re.findall(r"within 2 standard errors of the truth: (\d+) of (\d+)", said)[0]
    )
    assert of >= 54  # the legs', and those of trunk and arms that gait tells of
    assert within > 0.8 * of
    table = pd.read_csv(tmp_path / "parameters.csv", index_col="name")
    assert (table["standard_error"] > 0).all()
    assert table["true"].notna().all()
    assert float(re.findall(r"gait +knee_angle_r +\S+ +(\S+)", said)[0]) > 0


@pytest.mark.slow
def test_marker_set_script_compares_two_sets(
    kept: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    own = example("04_own_marker_set")

    def walking(out: Path, **_: object) -> Path:
        """Standing and walking alone, which is quicker."""
        study = copied_person(kept, out, noise=True)
        tables = study.read_text(encoding="utf-8").split("[[trial]]")
        used = [table for table in tables if 'role = "joint"' not in table]
        study.write_text("[[trial]]".join(used), encoding="utf-8")
        return study

    monkeypatch.setattr(gc, "synthesize", walking)
    with pytest.raises(SystemExit) as stopped:
        own.main([str(tmp_path), "one.toml"])
    assert stopped.value.code == 2
    own.main([str(tmp_path)])
    said = capsys.readouterr().out
    assert "my_markers: 36 markers on 10 segments" in said
    first, second = map(
        float, re.findall(r"gait: RMS marker error (\S+) mm, with the other set (\S+) mm", said)[0]
    )
    assert first != second
    change = re.findall(r"knee_angle_r: torque differs by (\S+) %", said)
    assert 0 < float(change[0]) < 1


@pytest.mark.slow
def test_notebook_runs_from_top_to_bottom(
    kept: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As it stands, but for the person, who is that of other tests."""
    nbformat = pytest.importorskip("nbformat", reason="extra `docs`")
    nbclient = pytest.importorskip("nbclient", reason="extra `docs`")
    pytest.importorskip("ipykernel", reason="extra `docs`")
    notebook = nbformat.read(EXAMPLES / "first_study.ipynb", as_version=4)
    nbformat.validate(notebook)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert not any(cell.outputs or cell.execution_count for cell in code), (
        "outputs are not committed"
    )
    lines = [
        "from functools import partial",
        "from pathlib import Path",
        "import gaitcal",
        "from tests.kept import copied_person",
        f"gaitcal.synthesize = partial(copied_person, Path({str(kept)!r}))",
    ]
    notebook.cells.insert(0, nbformat.v4.new_code_cell("\n".join(lines)))
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    nbclient.NotebookClient(
        notebook, timeout=300, resources={"metadata": {"path": str(tmp_path)}}
    ).execute()
    assert (tmp_path / "first-study" / "result" / "result.html").exists()
    assert (tmp_path / "first-study" / "walk.html").exists()
    shown = [output.get("data", {}) for cell in code for output in cell.outputs]
    tables = [data["text/html"] for data in shown if "<caption>" in data.get("text/html", "")]
    assert len(tables) == 4, "recording, calibration, walk and further trial"
    assert "iframe" in shown[-1]["text/html"] and any("image/png" in data for data in shown)
    printed = "".join(output.get("text", "") for cell in code for output in cell.outputs)
    assert printed.startswith("Study")
    assert float(re.findall(r"torque: (\S+) N·m", printed)[0]) < 2.0


ROWS = "time,knee_angle_r\n0.0,10.0\n0.1,{}\n"


@pytest.fixture
def folders(tmp_path: Path) -> tuple[Path, Path]:
    before = tmp_path / "before"
    before.mkdir()
    (before / "walk.csv").write_text(ROWS.format(20.0))
    (before / "summary.json").write_text(
        json.dumps({"seconds": 1.5, "status": "converged", "rms": 5.5}, indent=1)
    )
    np.savez(before / "splines.npz", coefficients=np.arange(4.0), trials=np.array(["walk"]))
    (before / "report.html").write_text("<p>before</p>")
    shutil.copytree(before, tmp_path / "after")
    return before, tmp_path / "after"


def test_the_same_is_the_same_whatever_time_it_took(
    folders: tuple[Path, Path], capsys: pytest.CaptureFixture
) -> None:
    before, after = folders
    (after / "summary.json").write_text(
        json.dumps({"seconds": 9.0, "status": "converged", "rms": 5.5}, indent=1)
    )
    (after / "walk.csv").write_text(ROWS.format(20.0 * (1 + 1e-10)))
    (after / "report.html").write_text("<p>after</p>")
    assert compare_results.main([str(before), str(after)]) == 0
    assert "1 pages" in capsys.readouterr().out


def test_other_numbers_gaps_words_arrays_and_missing_files_are_told(
    folders: tuple[Path, Path],
) -> None:
    before, after = folders
    of_run = {"seconds": 1.5, "status": "converged", "rms": 5.5}
    for name, content in (
        ("walk.csv", ROWS.format(20.0 * (1 + 1e-8))),
        ("walk.csv", ROWS.format("")),
        ("walk.csv", ROWS.format(20.0).replace("_r", "_l")),
        ("summary.json", json.dumps(of_run | {"status": "not converged"}, indent=1)),
        ("summary.json", json.dumps(of_run | {"rms": 5.5001}, indent=1)),
    ):
        (after / name).write_text(content)
        (line,) = compare_results.differences(before, after)
        assert line.startswith(f"{name}: ")
        shutil.copy(before / name, after / name)
    np.savez(after / "splines.npz", coefficients=np.arange(4.0) + 1e-6, trials=np.array(["walk"]))
    (after / "walk.csv").unlink()
    lines = list(compare_results.differences(before, after))
    assert [line.split(":")[0] for line in lines] == ["walk.csv", "splines.npz"]
