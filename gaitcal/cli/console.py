"""What a command prints: steps while it works, a table at the end. Nothing on standard output but
results.
"""

import logging
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

import rich.console
from rich.markup import escape
from rich.table import Table
from rich.text import Text

from gaitcal.runtime import Progress, silent


class Console:
    """Prints as much as the user asked for: quiet, normal or verbose."""

    def __init__(self, *, quiet: bool, verbose: bool) -> None:
        self.quiet, self.verbose = quiet, verbose
        logging.getLogger("gaitcal").setLevel(
            logging.ERROR if quiet else logging.WARNING
        )  # waiting for a lock
        self.out = rich.console.Console(quiet=quiet, highlight=False, soft_wrap=True)
        self.err = rich.console.Console(stderr=True, quiet=quiet, highlight=False)

    def line(self, text: str = "") -> None:
        """A line of the result."""
        self.out.print(Text(text))

    @contextmanager
    def working(self) -> Iterator[Progress]:
        """While working: a spinner with the present step on a terminal, plain lines with -v, else
        nothing.
        """
        if self.err.is_terminal and not self.quiet:
            with self.err.status("starting") as status:
                yield lambda text: status.update(escape(text))
        elif self.verbose:
            yield lambda text: self.err.print(Text(text))
        else:
            yield silent


def frameless_table(words: Iterable[str], numbers: Iterable[str] = ()) -> Table:
    """An empty table without a frame: columns of words to the left, then columns of numbers to the
    right.
    """
    table = Table(show_edge=False, pad_edge=False)
    for head in words:
        table.add_column(head)
    for head in numbers:
        table.add_column(head, justify="right")
    return table
