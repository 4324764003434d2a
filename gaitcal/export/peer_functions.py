"""Functions of one coordinate as OpenSim models hold them, evaluated without OpenSim.

`SimmSpline` is the cubic spline of Forsythe, Malcolm, Moler 1977 (chapter 4): at either end its third derivative is
that of the cubic through the four points there; beyond the points it goes on as a straight line.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline

from gaitcal.errors import InputError

Array = NDArray[np.float64]
Function = Callable[[float], float]

_SPLINES = ("SimmSpline", "NaturalCubicSpline", "natCubicSpline", "GCVSpline")
_TAGS = ("Constant", "LinearFunction", "PolynomialFunction", "PiecewiseLinearFunction", "MultiplierFunction", *_SPLINES)


def read_numbers(element: ET.Element | None, tag: str, source: Path, *, count: int | None = None) -> Array:
    """The numbers in the child `tag`; zeros (`count`) where it is absent; InputError where they are not numbers."""
    text = element.findtext(tag) if element is not None else None
    if text is None or not text.strip():
        return np.zeros(count or 0)
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        raise InputError(f"found '{text.strip()[:60]}', expected numbers", source=source, field=tag) from None
    if (count is not None and len(values) != count) or not np.isfinite(values).all():
        expected = "finite numbers" if count is None else f"{count} finite numbers"
        raise InputError(f"found '{text.strip()[:60]}', expected {expected}", source=source, field=tag)
    return values


def read_function(holder: ET.Element, source: Path) -> Function:
    """The function inside `holder` (a `TransformAxis` or a `MultiplierFunction`), of either generation of files."""
    wrapped = holder.find("function")
    inside = holder if wrapped is None else wrapped
    element = next((e for e in inside if e.tag in _TAGS), None)
    if element is None:
        found = ", ".join(e.tag for e in inside) or "nothing"
        raise InputError(f"found {found}, expected one of {', '.join(_TAGS)}", source=source, field="function")
    return _function(element, source)


def _function(element: ET.Element, source: Path) -> Function:
    if element.tag == "Constant":
        value = float(read_numbers(element, "value", source, count=1)[0])
        return lambda _: value
    if element.tag == "MultiplierFunction":
        scale, inner = float(read_numbers(element, "scale", source, count=1)[0]), read_function(element, source)
        return lambda x: scale * inner(x)
    if element.tag in ("LinearFunction", "PolynomialFunction"):
        coefficients = read_numbers(element, "coefficients", source)
        return lambda x: float(np.polyval(coefficients, x))
    x, y = read_numbers(element, "x", source), read_numbers(element, "y", source)
    if len(x) != len(y) or len(x) < 2 or (np.diff(x) <= 0).any():
        raise InputError("x must increase and have as many numbers as y", source=source, field=element.tag)
    if element.tag == "PiecewiseLinearFunction" or len(x) < 4:
        return lambda value: float(np.interp(value, x, y))
    return _spline(x, y)


def _spline(x: Array, y: Array) -> Function:
    ends = [6.0 * _third_difference(x[part], y[part]) for part in (slice(None, 4), slice(-4, None))]
    spline = make_interp_spline(x, y, k=3, bc_type=([(3, ends[0])], [(3, ends[1])]))
    slope = spline.derivative()

    def evaluate(value: float) -> float:
        inside = min(max(value, float(x[0])), float(x[-1]))
        return float(spline(inside) + slope(inside) * (value - inside))

    return evaluate


def _third_difference(x: Array, y: Array) -> float:
    for order in range(1, 4):
        y = np.diff(y) / (x[order:] - x[:-order])
    return float(y[0])
