"""What must be true of a result folder whatever was done to it: whole, of one model, nothing lost or left behind."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path

from gaitcal.files.ownership import AMENDED, MANIFEST
from gaitcal.files.snapshot import listed, sha256_of
from gaitcal.montecarlo.store import Store
from scripts.validation.folders.commands import MASSES, TRIALS, Bench

TIMED = frozenset({MANIFEST, "summary.json", "page.json", "result.html", "view.html", "settings.json"})
"""Files that tell times, or the hashes of those that do; the manifest says whether they are whole."""
PARTS = ("dynamics", "export", "montecarlo")


def hidden(folder: Path) -> set[str]:
    """What gaitcal leaves beside and inside a result only while it works."""
    out = {path.name for path in folder.parent.glob(".gaitcal-*")}
    for place, folders, files in os.walk(folder):  # pays no heed to what vanishes meanwhile
        below = Path(place).relative_to(folder)
        out |= {str(below / name) for name in (*folders, *files) if name.startswith(".gaitcal-")}
    return out


def content(folder: Path) -> dict[str, str]:
    """File -> SHA-256 of all that does not tell times."""
    files = sorted(p for p in folder.rglob("*") if p.is_file() and p.name not in TIMED)
    return {
        p.relative_to(folder).as_posix(): str(sha256_of(p))
        for p in files
        if ".gaitcal-" not in str(p.relative_to(folder))
    }


class References:
    """Files of the results that commands made alone, by model."""

    def __init__(self, bench: Bench) -> None:
        self.of: Mapping[str, Mapping[str, str]] = {name: content(bench.result(name)) for name in MASSES}
        self.model = {files["model.toml"]: name for name, files in self.of.items()}

    def faults(self, result: Path) -> Iterator[str]:
        """Everything that is wrong with a result, in words."""
        found = content(result)
        name = self.model.get(found.get("model.toml", ""))
        if name is None:
            yield "model.toml is of no calibration"
            return
        wanted = self.of[name]
        for file in wanted:
            if file.split("/")[0] not in PARTS and found.get(file) != wanted[file]:
                yield f"{file} is missing or not of the model beside it"
        yield from _manifest_faults(result)
        yield from self._dynamics_faults(result, found)
        yield from self._export_faults(result, found)
        yield from self._draw_faults(result)

    def _dynamics_faults(self, result: Path, found: Mapping[str, str]) -> Iterator[str]:
        folder = result / "dynamics"
        if not folder.exists():
            return
        yield from _manifest_faults(folder)
        made_with = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))["model_sha256"]
        told = set(json.loads((folder / "summary.json").read_text(encoding="utf-8"))["trials"])
        if set(made_with) != told:
            yield f"dynamics: manifest of {sorted(made_with)}, summary of {sorted(told)}"
        for trial in TRIALS:
            own = {f for f in found if f.startswith("dynamics/") and Path(f).stem == trial}
            if trial not in made_with:
                if own:
                    yield f"dynamics: files of {trial}, of which the manifest says nothing"
                continue
            name = self.model.get(made_with[trial])
            if name is None:
                yield f"dynamics: {trial} is of no model"
                continue
            for file, digest in self.of[name].items():
                if file.startswith("dynamics/") and Path(file).stem == trial and found.get(file) != digest:
                    yield f"{file} is missing or not of the model that the manifest names"

    def _export_faults(self, result: Path, found: Mapping[str, str]) -> Iterator[str]:
        mine = {f: h for f, h in found.items() if f.startswith("export/")}
        whole = [{f: h for f, h in of.items() if f.startswith("export/")} for of in self.of.values()]
        if mine and mine not in whole and not (result / "export" / AMENDED).exists():
            yield "export: files of several models, or not whole"

    def _draw_faults(self, result: Path) -> Iterator[str]:
        mine = {f: h for f, h in content(result).items() if f.startswith("montecarlo/")}
        allowed = [{f: h for f, h in of.items() if f.startswith("montecarlo/")} for of in self.of.values()]
        if mine and not any(mine.items() <= whole.items() for whole in allowed):
            yield f"montecarlo: files that no study alone made: {sorted(mine)}"


def _manifest_faults(folder: Path) -> Iterator[str]:
    """The manifest is whole, and every file is as it says."""
    hashes = listed(folder)
    if not hashes:
        yield f"{folder.name}: no hashes in the manifest"
    for file, digest in hashes.items():
        if sha256_of(folder / file) != digest:
            yield f"{folder.name}/{file} is not as the manifest says"


def trials_of(result: Path) -> set[str]:
    """Further trials in a result."""
    path = result / "dynamics" / "summary.json"
    return set(json.loads(path.read_text(encoding="utf-8"))["trials"]) if path.exists() else set()


def draws_of(result: Path) -> int:
    """Monte Carlo draws in a result."""
    return len(Store(result / "montecarlo").read())
