"""`gaitcal view`."""

from __future__ import annotations

from pathlib import Path

from gaitcal.commands.console import Talk
from gaitcal.files.amend import file_in_place
from gaitcal.files.snapshot import read_whole
from gaitcal.page import bones_of_folder, left_out, load_scene, serve, write_view

SCENE = "scene.npz"


def run(result: Path, html: Path | None, talk: Talk, geometry: Path | None = None) -> None:
    """Show a result in the browser, or write the page; bones of the folder `geometry`, else the installed ones."""
    bones = None if geometry is None else bones_of_folder(geometry)
    scene, _ = read_whole(result, (SCENE,), lambda: load_scene(result / SCENE))
    for sentence in left_out(scene):
        talk.line(sentence)
    if html is not None:
        with file_in_place(html) as page:
            write_view(scene, page, bones)
        talk.line(f"wrote {html}")
        return
    serve(scene, ready=lambda url: talk.line(f"{url}  (Ctrl-C ends)"), bones=bones)
