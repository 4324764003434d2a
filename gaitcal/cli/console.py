"""Output of commands: progress while they run, lines and tables at the end.

Results are printed to standard output, progress and errors to standard error.
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
    """Output in the amount that the user requested: quiet, normal or verbose.

    Parameters
    ----------
    quiet
        Print errors only.
    verbose
        Print every step and every assumption.
    """

    def __init__(self, *, quiet: bool, verbose: bool) -> None:
        self.quiet, self.verbose = quiet, verbose
        # The package logs that it waits for a lock.
        logging.getLogger("gaitcal").setLevel(logging.ERROR if quiet else logging.WARNING)
        self.out = rich.console.Console(quiet=quiet, highlight=False, soft_wrap=True)
        self.err = rich.console.Console(stderr=True, quiet=quiet, highlight=False)

    def print_line(self, text: str = "") -> None:
        """Print a line of the result to standard output."""
        self.out.print(Text(text))

    @contextmanager
    def show_progress(self) -> Iterator[Progress]:
        """Show the current step on standard error.

        A spinner on a terminal, else one line a step with `-v`, else nothing.

        Yields: call it with the text of each step.
        """
        if self.err.is_terminal and not self.quiet:
            with self.err.status("starting") as status:
                yield lambda text: status.update(escape(text))
        elif self.verbose:
            yield lambda text: self.err.print(Text(text))
        else:
            yield silent


def make_frameless_table(text_columns: Iterable[str], number_columns: Iterable[str] = ()) -> Table:
    """Make an empty table without a frame.

    Parameters
    ----------
    text_columns
        Headings of the first columns, aligned to the left.
    number_columns
        Headings of the columns after them, aligned to the right.

    Returns
    -------
    Table
    """
    table = Table(show_edge=False, pad_edge=False)
    for heading in text_columns:
        table.add_column(heading)
    for heading in number_columns:
        table.add_column(heading, justify="right")
    return table
