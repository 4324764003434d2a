"""Rows of numbers are those of `repr`, whatever the numbers are."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gaitcal.files.number_rows import is_plain, number_cells, rows_text

EDGES = [0.0, -0.0, 1e-4, 9.999999999999999e-5, 1e-5, 1e15, 1e16, 999999999999999.9, 123456789012345678.0, 5e-324, 0.1]
EDGES += [1.7976931348623157e308, 2.0**53, 2.0**53 - 1, 1 / 3, 1e22, 1e23, -1.5, math.inf, -math.inf, 4.35, 2.675]


def by_repr(values: np.ndarray, missing: str = "") -> str:
    rows = ["\t".join(missing if v != v else repr(v) for v in row) for row in values.tolist()]
    return "".join(f"{row}\n" for row in rows)


@given(st.lists(st.floats(width=64), min_size=1))
def test_every_float_is_as_repr_writes_it(numbers: list[float]) -> None:
    values = np.array(numbers)[:, None]
    assert rows_text(number_cells(values), "\t") == by_repr(values)


@pytest.mark.parametrize("missing", ["", "nan"])
def test_any_bits_and_the_edges(missing: str) -> None:
    bits = np.random.default_rng(3).integers(0, 2**63, 20_000)
    drawn = np.array([struct.unpack("d", struct.pack("q", b))[0] for b in bits.tolist()])
    usual = np.random.default_rng(4).normal(size=20_000) * 10.0 ** np.random.default_rng(5).integers(-7, 18, 20_000)
    edges = np.resize(EDGES, 20_000)
    values = np.column_stack([drawn, usual, edges, np.where(edges > 1.0, np.nan, usual)])
    assert rows_text(number_cells(values, missing), "\t") == by_repr(values, missing)


def test_whole_numbers_and_text_beside_them() -> None:
    columns = [number_cells(np.array([1, -2])), ["a b", "ü"], number_cells(np.array([0.5, np.nan]))]
    assert rows_text(list(zip(*columns, strict=True)), ",") == "1,a b,0.5\n-2,ü,\n"
    assert rows_text([], ",") == ""


@pytest.mark.parametrize("text", ['"', "\\", "a,b", "],[", "\n", "\x01"])
def test_text_that_would_not_stay_is_told(text: str) -> None:
    assert not is_plain(text)
    assert is_plain("knee_angle_r (2) ü; null 1e-5")
