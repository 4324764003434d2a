"""Short descriptions of objects, for a prompt and for a notebook."""

from collections.abc import Sequence
from html import escape


class Displayed:
    """Base class of objects that users print: a title and a few lines, each a label and a value.

    A dataclass that derives from it needs `repr=False`, else the decorator writes all fields out.
    """

    def _description(self) -> tuple[str, Sequence[tuple[str, str]]]:
        """Describe the object by a title and at most five pairs of label and value."""
        raise NotImplementedError

    def __repr__(self) -> str:
        """Show the description as text."""
        title, rows = self._description()
        width = max((len(label) for label, _ in rows), default=0)
        return "\n".join([title, *(f"  {label:<{width}}  {value}" for label, value in rows)])

    def _repr_html_(self) -> str:
        """Show the description as a table."""
        title, rows = self._description()
        cells = "".join(
            f"<tr><th>{escape(label)}</th><td>{escape(value)}</td></tr>" for label, value in rows
        )
        return f"<table><caption>{escape(title)}</caption>{cells}</table>"


def shorten(names: Sequence[str], most: int = 6) -> str:
    """List names, and count those beyond the first few."""
    more = len(names) - most
    return ", ".join(names[:most]) + (f" and {more} more" if more > 0 else "")


def describe_time(frames: int, rate: float, duration: float) -> str:
    """Describe a recording's extent: frames, frames per second and seconds."""
    return (
        f"{frames} frames, {rate:.4g} Hz, {duration:.2f} s"
        if frames > 1
        else f"{frames} frame{'s' * (frames != 1)}"
    )
