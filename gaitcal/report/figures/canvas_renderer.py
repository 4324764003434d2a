"""Draw figures of matplotlib on the pages of a PDF document of reportlab, as vectors."""

from typing import Any, Final

import numpy as np
from matplotlib.backend_bases import GraphicsContextBase, RendererBase
from matplotlib.colors import to_rgba
from matplotlib.font_manager import FontProperties
from matplotlib.path import Path
from matplotlib.transforms import Transform
from matplotlib.typing import ColorType
from reportlab.lib.colors import Color
from reportlab.pdfgen.canvas import Canvas

CAPS: Final = {"butt": 0, "round": 1, "projecting": 2}
JOINS: Final = {"miter": 0, "round": 1, "bevel": 2}


class CanvasRenderer(RendererBase):
    """Renderer of a figure with 72 dots per inch: a dot is a point of the page.

    Parameters
    ----------
    canvas
        Its origin is the lower left corner of the figure.
    size
        Width and height of the figure, pt.
    fonts
        Names of the normal and the bold font of the document.
    """

    def __init__(self, canvas: Canvas, size: tuple[float, float], fonts: tuple[str, str]) -> None:
        super().__init__()
        self.canvas, self.size, self.fonts = canvas, size, fonts

    def get_canvas_width_height(self) -> tuple[float, float]:
        """Return the size of the figure."""
        return self.size

    def flipy(self) -> bool:
        """Return False: the vertical axis points up."""
        return False

    def draw_path(
        self,
        gc: GraphicsContextBase,
        path: Path,
        transform: Transform,
        rgbFace: ColorType | None = None,
    ) -> None:
        """Draw and fill a path."""
        canvas, drawn = self.canvas, self.canvas.beginPath()
        for points, code in path.iter_segments(transform, curves=False):
            if code == Path.CLOSEPOLY:
                drawn.close()
            else:
                (drawn.moveTo if code == Path.MOVETO else drawn.lineTo)(*points)
        canvas.saveState()
        box = gc.get_clip_rectangle()
        if box is not None:
            clip = canvas.beginPath()
            clip.rect(*box.bounds)
            canvas.clipPath(clip, stroke=0, fill=0)
        if rgbFace is not None:
            opacity = gc.get_alpha() if gc.get_forced_alpha() else None
            canvas.setFillColor(Color(*to_rgba(rgbFace, opacity)))
        canvas.setStrokeColor(Color(*gc.get_rgb()))
        canvas.setLineWidth(gc.get_linewidth())
        canvas.setLineCap(CAPS[gc.get_capstyle()])
        canvas.setLineJoin(JOINS[gc.get_joinstyle()])
        canvas.setDash(np.ravel(gc.get_dashes()[1] or []).tolist())
        canvas.drawPath(drawn, stroke=int(gc.get_linewidth() > 0), fill=int(rgbFace is not None))
        canvas.restoreState()

    def draw_text(
        self,
        gc: GraphicsContextBase,
        x: float,
        y: float,
        s: str,
        prop: FontProperties,
        angle: float,
        ismath: Any = False,
        mtext: Any = None,
    ) -> None:
        """Draw a line of text."""
        canvas = self.canvas
        canvas.saveState()
        canvas.translate(x, y)
        canvas.rotate(angle)
        canvas.setFillColor(Color(*gc.get_rgb()))
        canvas.setFont(self.fonts[prop.get_weight() == "bold"], prop.get_size_in_points())
        canvas.drawString(0, 0, s)
        canvas.restoreState()
