"""Curves of matplotlib on a page of reportlab: what stands in the page's stream."""

from io import BytesIO

from matplotlib.figure import Figure
from reportlab.pdfgen.canvas import Canvas

from gaitcal.report.figures.canvas_renderer import CanvasRenderer


def test_clip_opacity_dashes_and_round_joins_are_in_the_page() -> None:
    figure = Figure(figsize=(2, 1), dpi=72)
    axes = figure.add_axes((0.1, 0.1, 0.8, 0.8))
    axes.fill_between([0, 1], [0, 1], alpha=0.25)
    axes.plot([0, 5, 10], [0, 40, 0], linewidth=2.0, dashes=(3.0, 1.5), color="#112233")
    axes.set_xlim(0, 1)
    axes.set_xticks([0.5], ["half"])
    canvas = Canvas(BytesIO())
    figure.draw(CanvasRenderer(canvas, (144, 72), ("Helvetica", "Helvetica-Bold")))
    text = "\n".join(canvas._code)
    assert text.count("14.4 7.2 115.2 57.6 re W* n") == 2, "the axes clip area and curve"
    assert ("ca", 0.25) in canvas._extgstate._c, "a state with this opacity"
    assert "[6 3] 0 d" in text, "dashes in units of the line width"
    assert "1 j" in text and "2 w" in text
    assert ".066667 .133333 .2 RG" in text
    assert "(half) Tj" in text
