"""The table of outcomes, and every attack that ended badly."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from scripts.validation.attacks.attack import Ending, Kind, Result

SILENT_SHARE, ALARMED_SHARE = 0.02, 0.10
"""Largest shares of all attacks that may end so."""
LONGEST = 320
"""Letters of a message that are shown."""


def lines(results: Sequence[Result]) -> Iterator[str]:
    """The table by outcome and kind, then those that ended badly, with what was said."""
    kinds = [kind for kind in Kind if any(r.kind is kind for r in results)]
    yield f"{'':22}" + "".join(f"{ending.value:>10}" for ending in Ending) + f"{'all':>8}"
    for kind in (*kinds, None):
        of_kind = [r for r in results if kind in (None, r.kind)]
        counts = [sum(r.ending is ending for r in of_kind) for ending in Ending]
        yield f"{kind.value if kind else 'all':22}" + "".join(f"{c:10d}" for c in counts) + f"{len(of_kind):8d}"
    total = max(len(results), 1)
    yield f"{'per cent':22}" + "".join(
        f"{100 * sum(r.ending is ending for r in results) / total:10.1f}" for ending in Ending
    )
    for ending in (Ending.CRASH, Ending.SILENT, Ending.ALARMED):
        found = [r for r in results if r.ending is ending]
        if found:
            yield f"\n{ending.value}: {len(found)}"
        for r in sorted(found, key=lambda r: -(r.moved or 0.0)):
            yield line(r)
            yield from (f"      {_shortened(message)}" for message in r.messages)
    astray = [r for r in results if r.ending is Ending.REFUSED and not r.cause_told]
    if astray:
        yield f"\nrefused, but with other words than expected: {len(astray)}"
        for r in astray:
            yield line(r)
            yield from (f"      {_shortened(message)}" for message in r.messages[:3])


def line(r: Result) -> str:
    """One result in one line."""
    moved = "" if r.moved is None else f" {r.moved:.1f} error bars"
    return f"  {r.ending.value:9}{r.attack}:{moved} ({r.where})" if r.where else f"  {r.ending.value:9}{r.attack}"


def _shortened(message: str) -> str:
    text = " ".join(message.split())
    return text if len(text) <= LONGEST else text[:LONGEST] + " ..."


def passed(results: Sequence[Result]) -> bool:
    """Whether the shares are within their limits and nothing crashed."""
    count = {ending: sum(r.ending is ending for r in results) for ending in Ending}
    return (
        count[Ending.CRASH] == 0
        and count[Ending.SILENT] <= SILENT_SHARE * len(results)
        and count[Ending.ALARMED] <= ALARMED_SHARE * len(results)
    )
