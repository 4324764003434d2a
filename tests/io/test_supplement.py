"""A C3D file that was given further points holds all that it had but for what is named, and they,
for two readers.
"""

import warnings
from pathlib import Path
from typing import Any

import ezc3d
import numpy as np
import pytest

from gaitcal.errors import Code
from gaitcal.io.c3d.writer import AddedPoint, PointKind, open_c3d_original, supplement_c3d
from gaitcal.io.formats import read_recording
from gaitcal.io.labels import FootEvent, FootMoment
from tests.export.peer_programs import peer
from tests.messages import refuses

FILES = (
    "c3d_formats/Eb015pi.c3d",
    "c3d_formats/Eb015pr.c3d",
    "c3d_formats/Eb015vr.c3d",
    "c3d_formats/TYPE-1.C3D",
    "c3d_formats/TYPE-4.C3D",
    "children/HC002D/straight.c3d",
    "labs_c3d/kad/walk.c3d",
    "pig_c3d/gait.c3d",
)
INTEGERS = ("Eb015pi.c3d", "TYPE-4.C3D")
ASKEW = ("TYPE-1.C3D",)
"""ezc3d takes its analog samples for points."""
DOUBLED = ("gait.c3d",)
"""Its own parameters hold a name twice, which the second reader refuses."""
CHANNELS = tuple(
    f"ANALOG:{name}" for name in ("LABELS", "DESCRIPTIONS", "SCALE", "OFFSET", "UNITS")
)
MODEL = (
    "IS_STATIC",
    "USES_PREFIXES",
    "USED",
    "NAMES",
    "LABEL_PREFIXES",
    "MARKER_SETS",
    "DISPLAY_SETS",
    "MODELS",
)
NAMELESS = tuple(f"7:{name}" for name in (*MODEL, "MODEL_PARAMS"))
NOT_COPIED: dict[str, tuple[str, ...]] = {
    **dict.fromkeys(FILES[:2], CHANNELS),  # names of more channels than there are
    FILES[2]: (*CHANNELS, "residuals of points"),  # DEC
    FILES[3]: (),
    FILES[4]: (*NAMELESS, "ANALOG:OFFSET"),
    **dict.fromkeys(FILES[5:], ("POINT:TYPE_GROUPS",)),  # a table of two columns becomes a list
}
SINGLE = 2.0**-23
"""Relative rounding of a 32-bit float, which integers times a scale suffer."""
EVENTS = (FootEvent(FootMoment.STRIKE, "r", 1.25), FootEvent(FootMoment.OFF, "l", 61.5))


def added(frames: int) -> list[AddedPoint]:
    values = np.random.default_rng(7).normal(size=(frames, 3)).astype(np.float32).astype(np.float64)
    values[::7] = np.nan
    kinds = list(PointKind)
    return [
        AddedPoint(name=f"zz{k}", kind=kinds[k % 4], values=values + k, description="new " * k)
        for k in range(9)
    ]


def supplemented(source: Path, target: Path) -> tuple[list[AddedPoint], tuple[str, ...]]:
    frames = len(read_recording(source).time)
    points = added(frames)
    lost = supplement_c3d(
        open_c3d_original(source, frames),
        target,
        points,
        EVENTS,
        ("GAITCAL", {"VERDICT": ["doubtful"]}),
    )
    return points, lost


def texts_of(file: Any, name: str) -> list[str]:
    group = file["parameters"]["POINT"]
    parts = [name, *(f"{name}{n}" for n in range(2, 5))]
    return [text for part in parts if part in group for text in group[part]["value"]]


@pytest.mark.parametrize("name", FILES)
def test_everything_is_kept(data_dir: Path, tmp_path: Path, name: str) -> None:
    source, target = data_dir / name, tmp_path / "more.c3d"
    points, lost = supplemented(source, target)
    assert lost == NOT_COPIED[name]
    before, after = read_recording(source), read_recording(target)
    assert after.labels == before.labels
    rounding = SINGLE if source.name in INTEGERS else 0.0
    assert np.allclose(before.markers, after.markers, rtol=rounding, atol=0.0, equal_nan=True)
    for old, new in zip(before.plates, after.plates, strict=True):
        assert np.array_equal(old.wrench(), new.wrench())
    assert sorted((*before.events, *EVENTS), key=lambda e: e.time) == list(after.events)
    assert before.facts == after.facts
    if source.name in ASKEW:
        return
    a, b = ezc3d.c3d(str(source)), ezc3d.c3d(str(target))
    count = a["data"]["points"].shape[1]
    assert np.array_equal(a["data"]["analogs"], b["data"]["analogs"], equal_nan=True)
    residuals = [f["data"]["meta_points"]["residuals"][:, :count] for f in (a, b)]
    assert np.array_equal(*residuals)
    for k, point in enumerate(points):
        found = b["data"]["points"][:3, count + k].T
        assert np.array_equal(
            found.astype(np.float32), point.values.astype(np.float32), equal_nan=True
        )
        assert (b["data"]["meta_points"]["residuals"][0, count + k] < 0).tolist() == np.isnan(
            found[:, 0]
        ).tolist()
        assert point.name in texts_of(b, point.kind.value[0])
    assert texts_of(b, "LABELS")[count:] == [point.name for point in points]
    assert texts_of(b, "DESCRIPTIONS")[count:] == [point.description.strip() for point in points]
    assert b["parameters"]["GAITCAL"]["VERDICT"]["value"] == ["doubtful"]
    for group, entries in a["parameters"].items():
        for entry, old_entry in entries.items():
            if (
                group not in ("POINT", "EVENT")
                and entry != "__METADATA__"
                and f"{group}:{entry}" not in lost
                and group
            ):
                new_entry = b["parameters"][group][entry]
                assert np.array_equal(old_entry["value"], new_entry["value"])
                assert old_entry["type"] == new_entry["type"]


@pytest.mark.peers
@pytest.mark.parametrize("name", [name for name in FILES if Path(name).name not in DOUBLED])
def test_a_second_reader(data_dir: Path, tmp_path: Path, name: str) -> None:
    """The package `c3d` shares no line with ezc3d; it gives residuals and camera masks beside
    coordinates.
    """
    c3d = peer("c3d")
    target = tmp_path / "more.c3d"
    points, _ = supplemented(data_dir / name, target)
    frames = []
    for path in (data_dir / name, target):
        with path.open("rb") as stream, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            read = [(p.copy(), a.copy()) for _, p, a in c3d.Reader(stream).read_frames()]
        frames.append((np.stack([p for p, _ in read]), np.stack([a for _, a in read])))
    (old, old_analog), (new, new_analog) = frames
    assert np.array_equal(
        old.astype(np.float32), new[:, : old.shape[1]].astype(np.float32), equal_nan=True
    )
    assert np.array_equal(old_analog, new_analog, equal_nan=True)
    for k, point in enumerate(points):
        found, known = new[:, old.shape[1] + k], np.isfinite(point.values[:, 0])
        assert np.array_equal(found[known, :3], point.values[known].astype(np.float32))
        assert (found[~known, 3] < 0).all() and not found[~known, :3].any()


def test_limits_are_told(data_dir: Path, tmp_path: Path) -> None:
    source = data_dir / "labs_c3d/kad/walk.c3d"
    frames = len(read_recording(source).time)
    many = [FootEvent(FootMoment.STRIKE, "r", 0.1 * k) for k in range(255)]
    with refuses(Code.NOT_WRITABLE, 255, source="walk.c3d"):
        supplement_c3d(open_c3d_original(source, frames), tmp_path / "a.c3d", added(frames), many)
    with refuses(Code.DAMAGED_RECORDING, source="walk.c3d"):
        supplement_c3d(
            open_c3d_original(source, 10 * frames), tmp_path / "a.c3d", added(10 * frames)
        )
    with refuses(Code.NOT_WRITABLE, source="walk.c3d"):
        supplement_c3d(open_c3d_original(source, frames), tmp_path / "a.c3d", added(frames - 1))
    assert not list(tmp_path.iterdir())
