"""Every number above a panel is the one that the files of the result have at that instant, of each
leg at its own.
"""

import io
import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from gaitcal.gait.conventions import Acting, Convention, MomentUnit, Signs
from gaitcal.gait.cycles import CurveKind
from gaitcal.model.coordinates import FOOT_PROGRESSION
from gaitcal.model.linkage import PELVIS_ANGLES
from gaitcal.model.subject_model import Subject
from tests.report.page.browser import Page, Visit
from tests.results.test_cycles_export import kept_strides

pytestmark = pytest.mark.browser

PACKED = 1e-4
"""Of the range of a curve, which stands in 16 bits; frames are 32-bit times."""
FOLDERS = {CurveKind.ANGLE: "motion", CurveKind.MOMENT: "moments", CurveKind.POWER: "powers"}
WAYS = {
    "ground_reaction_forward": "x",
    "ground_reaction_vertical": "y",
    "ground_reaction_sideways": "z",
}
SIDES = ("r", "l", "")
READ = f"""gaitcal.curves.panels.filter((panel) => panel.traces).flatMap((panel) => {list(SIDES)}.map((side) =>
    [panel.subject.base, panel.subject.kind, side, panel.value(side, gaitcal.curves.now), gaitcal.curves.now[side]]))
    .filter(([, , , text]) => text && text !== 'not valid')"""


def readings(page: Page) -> list[tuple[str, CurveKind, str, float, float, float]]:
    """Base, kind, side, value and half its last digit, and percent of the leg's stride."""
    out = []
    for base, kind, side, text, percent in page.run(READ):
        number = text.split(" ")[0].replace("\u2212", "-").replace("\u202f", "")
        half = 0.5 * 10.0 ** -len(number.partition(".")[2])
        out.append(
            (
                base,
                next(k for k in CurveKind if k.label == kind),
                side,
                float(number),
                half,
                percent,
            )
        )
    return out


def column_of(table: pd.DataFrame, base: str, side: str, kind: CurveKind) -> Any:
    if kind is CurveKind.FORCE:
        return table[f"ground_force_{side}_v{WAYS[base]}"].to_numpy()
    ending = CurveKind.POWER.ending if kind is CurveKind.POWER else ""
    names = [f"{base}{ending}_{side}", f"{base}_{side}{ending}", f"{base}{ending}", base]
    return table[next(name for name in names if name in table)].to_numpy()


@pytest.mark.parametrize("axis", ["percent", "time"])
def test_each_leg_is_read_at_its_own_instant(axis: str, visit: Visit, kept: Path) -> None:
    folder = kept_strides(kept)
    page = visit(folder / "result.html", 1280, 900)
    page.run("gaitcal.clock.play(false)")
    name = page.run("gaitcal.trial.name")
    tables = {
        kind: pd.read_csv(folder / of / f"{name}.csv", comment="#") for kind, of in FOLDERS.items()
    }
    forces = (folder / "forces" / f"{name}.mot").read_text().partition("endheader\n")[2]
    tables[CurveKind.FORCE] = pd.read_csv(io.StringIO(forces), sep="\t")
    cycles = pd.read_csv(folder / "cycles.csv", comment="#").query(f"trial == '{name}'")
    person = page.run("gaitcal.result.sheet.person")
    subject = Subject(name="", mass=person["mass"], height=person["height"], sex="male")
    time, read, kinds = tables[CurveKind.ANGLE]["time"].to_numpy(), 0, set()
    for signs, acting in itertools.product(Signs, Acting):
        page.run(f"""gaitcal.state.set({{ axis: '{axis}', signs: '{signs.value}', acting: '{acting.key}' }});
            gaitcal.curves.draw(gaitcal.curves.panels); true""")
        convention = Convention(signs=signs, acting=acting, unit=MomentUnit.NM_PER_KG)
        for frame in np.linspace(0, len(time) - 1, 12).astype(int)[1:-1]:
            page.run(
                f"gaitcal.clock.seek(gaitcal.curves.strides.trial.frame({time[frame] - time[0]}))"
            )
            for base, kind, side, shown, half, percent in readings(page):
                if base in (*PELVIS_ANGLES, FOOT_PROGRESSION):
                    if axis == "time":  # against the trial's line of walking, which no file has
                        continue
                    rows = cycles.query(
                        f"side == '{side}' and variable == '{base}'"
                    )  # one stride of either foot
                    column = rows["value"].to_numpy()
                    file = np.interp(percent, rows["percent"], column)
                else:
                    column = column_of(tables[kind], base, side, kind)
                    file = column[frame]
                size = float(np.nanmax(column) - np.nanmin(column))
                scale = 1.0 if kind is CurveKind.ANGLE else 1.0 / subject.mass
                told = convention.values(f"{base}{kind.ending}", np.array([file]), side, subject)[0]
                told *= scale if kind is CurveKind.FORCE else 1.0
                assert shown == pytest.approx(told, abs=half + PACKED * size * scale), (
                    base,
                    kind,
                    side,
                    frame,
                )
                read += 1
                kinds.add(kind)
    assert page.run("gaitcal.curves.strides.percent") is (axis == "percent")
    assert read > 4 * 10 * 20 and kinds == set(CurveKind)
    assert page.console == []
