"""Is everything explained, and does every link of the built site lead somewhere?

    python -m scripts.tools.documentation [--site site/latest] [--table]

Every command, option, key of a TOML file, marker set, result file, column, finding code and public Python name needs a
page (`--table` prints which). With `--site`: links and anchors within it; addresses elsewhere are listed, never
fetched. Exit code 1 where something is missing.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from scripts.tools.documentation import coverage, links


def main(arguments: Sequence[str] | None = None) -> int:
    """Print what is missing."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--site", type=Path, help="folder of the built site")
    parser.add_argument("--table", action="store_true", help="print what is explained where")
    chosen = parser.parse_args(arguments)
    if chosen.table:
        print(coverage.markdown())
    faults = coverage.faults()
    counts = Counter(item.kind for item in coverage.items())
    print("explained: " + ", ".join(f"{number} of kind '{kind}'" for kind, number in counts.items()))
    if chosen.site is not None:
        found = links.check(chosen.site)
        print(f"links: {found.inside} within {found.pages} pages, {len(found.broken)} broken")
        faults += [f"broken link: {link}" for link in found.broken]
        faults += [f"type without a page: {name}" for name in found.unexplained]
        faults += [f"loaded from elsewhere: {address}" for address in found.fetched]
        for address in found.outside:
            print(f"leads out: {address}")
    for fault in faults:
        print(fault, file=sys.stderr)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
