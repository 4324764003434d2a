"""What goes wrong with all markers of a file at once: unit, axes, clock."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from gaitcal import MarkerSet, Recording
from scripts.validation.attacks.markers import Change, Part, frames


def scaled(factor: float) -> Change:
    """All positions times a factor: another unit, or a person of another size."""
    return lambda recording, markers: replace(recording, markers=factor * recording.markers)


def axes(order: tuple[int, int, int], signs: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> Change:
    """Axes of the markers in another order, or turned round."""
    return lambda recording, markers: replace(recording, markers=recording.markers[:, :, order] * np.array(signs))


def tilted(degrees: float, axis: str = "x") -> Change:
    """The room of the markers turned against that of the plates."""
    turn = Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    return lambda recording, markers: replace(recording, markers=recording.markers @ turn.T)


def other_rate(factor: float) -> Change:
    """A header that tells `factor` times the true frame rate; the forces keep their own clock."""
    return lambda recording, markers: replace(recording, time=recording.time / factor)


def frames_dropped(part: Part) -> Change:
    """Frames that the file lacks, the rest moved up as if there had been no gap."""

    def spoil(recording: Recording, markers: MarkerSet) -> Recording:
        gone = np.arange(len(recording.time))[frames(recording, part)]
        kept = np.delete(recording.markers, gone, axis=0)
        return replace(recording, time=recording.time[: len(kept)], markers=kept)

    return spoil


def frame_lost(share: float, count: int = 1) -> Change:
    """So many frames are missing at a share of the trial, and the times are numbered on as if nothing were."""

    def spoil(recording: Recording, markers: MarkerSet) -> Recording:
        at = round(share * len(recording.time))
        kept = np.delete(recording.markers, np.arange(at, at + count), axis=0)
        return replace(recording, time=recording.time[: len(kept)], markers=kept)

    return spoil


def frame_twice(share: float) -> Change:
    """One frame stands in the file twice, and the last one is left out."""

    def spoil(recording: Recording, markers: MarkerSet) -> Recording:
        at = round(share * len(recording.time))
        twice = np.insert(recording.markers, at, recording.markers[at], axis=0)
        return replace(recording, markers=twice[:-1])

    return spoil


def backwards(recording: Recording, markers: MarkerSet) -> Recording:
    """Played from the end to the beginning."""
    return replace(recording, markers=recording.markers[::-1].copy())


def hardly_moving(share: float) -> Change:
    """Every marker stays near its mean."""

    def spoil(recording: Recording, markers: MarkerSet) -> Recording:
        mean = np.nanmean(recording.markers, axis=0)
        return replace(recording, markers=mean + share * (recording.markers - mean))

    return spoil


def cropped(part: Part) -> Change:
    """Only a part of the frames."""

    def spoil(recording: Recording, markers: MarkerSet) -> Recording:
        where = frames(recording, part)
        return replace(recording, time=recording.time[where], markers=recording.markers[where])

    return spoil
