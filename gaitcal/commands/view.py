"""`gaitcal view`."""

from __future__ import annotations

from pathlib import Path

from gaitcal.commands.console import Talk
from gaitcal.page import left_out, load_scene, serve, write_view


def run(result: Path, html: Path | None, talk: Talk) -> None:
    """Show a result in the browser, or write the page."""
    scene = load_scene(result / "scene.npz")
    for sentence in left_out(scene):
        talk.line(sentence)
    if html is not None:
        write_view(scene, html)
        talk.line(f"wrote {html}")
        return
    serve(scene, ready=lambda url: talk.line(f"{url}  (Ctrl-C ends)"))
