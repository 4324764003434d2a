"""A release, up to but without its publication: wheel and sdist, checked in clean environments, and
its notes.

    python -m scripts.tools.release [--out dist] [--section Unreleased] [--allow-changes]
    [--skip-demo] [--notes]

Asks that package, citation and changelog tell one version, and that nothing in the checkout is
uncommitted; builds wheel and sdist (`python -m build`), lets `twine check --strict` judge them,
installs each of them into an environment of its own and runs `gaitcal demo` there, far from the
checkout. Then OUT holds both files, `SHA256SUMS` and `NOTES.md`: the changelog's section of this
version. `--notes` prints these and does nothing else. Uploads nothing.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import re
import subprocess
import sys
import tarfile
import tempfile
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
TOOLS = ("build>=1.2", "twine>=6.1")
DEMO_FILES = ("result.html", "page.json", "parameters.csv", "moments/gait.csv", "manifest.json")
"""What `gaitcal demo` must have written."""
PACKED = (
    "models/nominal_subject.json",
    "models/examples.toml",
    "py.typed",
    "page/templates/page.html",
)
"""Data without which the program is incomplete, in `gaitcal/` of the wheel."""


def version_of(root: Path = ROOT) -> str:
    """The version, which package, citation and changelog must tell alike."""
    texts = {
        n: (root / n).read_text(encoding="utf-8")
        for n in ("pyproject.toml", "CITATION.cff", "CHANGELOG.md")
    }
    patterns = {
        "pyproject.toml": r'^version = "(.+)"$',
        "CITATION.cff": r"^version: \"?([^\"\n]+)\"?$",
        "CHANGELOG.md": r"^## \[(\d[^\]]*)\] - \d{4}-\d\d-\d\d$",
    }
    found = {name: re.findall(pattern, texts[name], re.M)[:1] for name, pattern in patterns.items()}
    told = {name: (versions or ["none"])[0] for name, versions in found.items()}
    if len(set(told.values())) != 1:
        raise SystemExit(
            "not one version: " + ", ".join(f"{name} says {v}" for name, v in told.items())
        )
    return told["pyproject.toml"]


def notes(changelog: str, section: str) -> str:
    """The text below `## [section]` of a changelog, without its heading; links that it names are
    kept.

    Raises
    ------
    SystemExit
        There is no such section, or it is empty.
    """
    parts = re.split(r"^## \[([^\]]+)\].*$", changelog, flags=re.M)
    sections = dict(zip(parts[1::2], parts[2::2], strict=True))
    if section not in sections:
        raise SystemExit(f"CHANGELOG.md has no section [{section}]; it has {', '.join(sections)}")
    links = dict(re.findall(r"^(\[[^\]]+\]): (\S+)$", changelog, re.M))
    text = re.sub(r"^\[[^\]]+\]: \S+$\n?", "", sections[section], flags=re.M).strip()
    if not text:
        raise SystemExit(f"CHANGELOG.md tells nothing under [{section}]")
    named = [f"{name}: {address}" for name, address in links.items() if name in text]
    return "\n".join([text, *([""] if named else []), *named]) + "\n"


def run(*words: str | Path, cwd: Path = ROOT) -> str:
    """Run a program away from our own modules; its output. SystemExit with its words where it
    fails.
    """
    environment = {
        k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "VIRTUAL_ENV"))
    }
    print("$", *(Path(word).name if isinstance(word, Path) else word for word in words), flush=True)
    done = subprocess.run(
        [str(w) for w in words], cwd=cwd, env=environment, capture_output=True, text=True
    )
    if done.returncode != 0:
        raise SystemExit(
            f"{done.stdout}{done.stderr}\nfailed with {done.returncode}: "
            f"{' '.join(map(str, words))}"
        )
    return done.stdout


def environment(folder: Path, *packages: str | Path) -> Path:
    """A new virtual environment with these packages; its folder of programs."""
    try:
        run(sys.executable, "-m", "venv", folder)
        pip: tuple[str | Path, ...] = (folder / "bin/python", "-m", "pip")
    except SystemExit:  # Debian without ensurepip: the system's pip works on the environment
        run(sys.executable, "-m", "venv", "--clear", "--without-pip", folder)
        pip = (sys.executable, "-m", "pip", "--python", folder / "bin/python")
    run(*pip, "install", "--quiet", "--disable-pip-version-check", *packages)
    return folder / "bin"


def built(out: Path, work: Path) -> tuple[Path, Path]:
    tools = environment(work / "tools", *TOOLS)
    run(tools / "python", "-m", "build", "--outdir", out, ROOT)
    (wheel,) = out.glob("*.whl")
    (sdist,) = out.glob("*.tar.gz")
    run(tools / "python", "-m", "twine", "check", "--strict", wheel, sdist)
    return wheel, sdist


def check_content(wheel: Path, sdist: Path) -> None:
    """Nothing is missing, and nothing is in them that nobody asked for."""
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    missing = [name for name in PACKED if f"gaitcal/{name}" not in names]
    alien = [name for name in names if not name.startswith(("gaitcal/", "gaitcal-"))]
    with tarfile.open(sdist) as packed:
        top = {name.split("/")[1] for name in packed.getnames() if "/" in name}
    missing += [
        name
        for name in ("pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md")
        if name not in top
    ]
    alien += [name for name in top if name in ("dist", "build", ".venv", ".git")]
    if missing or alien:
        raise SystemExit(f"packed wrongly: missing {missing}, not ours {alien}")


def smoke(package: Path, folder: Path, version: str, *, demo: bool) -> None:
    programs = environment(folder / "venv", package)
    code = "import gaitcal, importlib.metadata as m; print(m.version('gaitcal'), gaitcal.__file__)"
    told, place = run(programs / "python", "-c", code, cwd=folder).split(maxsplit=1)
    if told != version or "site-packages" not in place:
        raise SystemExit(f"{package.name}: installed is version {told} in {place}")
    run(programs / "gaitcal", "--help", cwd=folder)
    run(programs / "gaitcal", "example", cwd=folder)
    if demo:
        print(run(programs / "gaitcal", "demo", "--out", "demo", cwd=folder).strip())
        missing = [name for name in DEMO_FILES if not (folder / "demo/result" / name).is_file()]
        if missing:
            raise SystemExit(f"{package.name}: the demo wrote no {', '.join(missing)}")


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--out", type=Path, default=ROOT / "dist", help="a folder without packages (default dist)"
    )
    parser.add_argument("--section", help="of the changelog; that of the version unless given")
    parser.add_argument(
        "--allow-changes", action="store_true", help="go on with uncommitted changes"
    )
    parser.add_argument("--skip-demo", action="store_true", help="install, but run no demo")
    parser.add_argument("--notes", action="store_true", help="print the notes, do nothing else")
    chosen = parser.parse_args(arguments)
    version = version_of()
    text = notes((ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), chosen.section or version)
    if chosen.notes:
        print(text, end="")
        return
    if not chosen.allow_changes and run("git", "status", "--porcelain").strip():
        raise SystemExit("there are uncommitted changes; commit them, or --allow-changes")
    out: Path = chosen.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    if any(out.iterdir()):
        raise SystemExit(f"{out} is not empty; a release starts from an empty folder")
    with tempfile.TemporaryDirectory(prefix="gaitcal-release-") as name:
        work = Path(name)
        packages = built(out, work)
        check_content(*packages)
        for package in packages:
            folder = work / ("wheel" if package.suffix == ".whl" else "sdist")
            folder.mkdir()
            smoke(package, folder, version, demo=not chosen.skip_demo)
    sums = [
        f"{hashlib.sha256(package.read_bytes()).hexdigest()}  {package.name}"
        for package in packages
    ]
    (out / "SHA256SUMS").write_text("\n".join(sums) + "\n", encoding="utf-8")
    (out / "NOTES.md").write_text(text, encoding="utf-8")
    print(
        f"gaitcal {version}: {out} holds {', '.join(sorted(path.name for path in out.iterdir()))}; "
        "nothing uploaded"
    )


if __name__ == "__main__":
    main()
