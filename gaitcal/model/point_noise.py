"""How points err that are no markers on skin: the corners of segment poses, the key points of markerless programs.

A marker's error is skin that moves with the joints (`calibration/soft_tissue_artefact.py`), and cameras that err by
tenths of a millimetre: the residuals tell both. What a program sees in pictures errs otherwise. Most of it is constant:
the joint centre of thousands of annotated pictures is not this person's, which no residual shows, and which joints and
axes are widened by (`joints`). The rest changes as slowly as what the cameras see, so that frames near to each other
say the same (`memory_s`); and where the program has fitted a body of its own, its residuals are smaller than its errors
(`size_mm` is the least that is believed of them).
"""

from pydantic import Field

from gaitcal.io.toml import Table


class PointNoise(Table):
    """The table `[noise]` of a marker set and of a model."""

    size_mm: float = Field(gt=0, description="how far a coordinate of a point errs, constants left out, in mm")
    memory_s: float = Field(gt=0, description="how long such an error lasts, in s")
    joints: float = Field(ge=1, description="times as far as by palpated markers joints and segments' axes may be off")
    hinges: float = Field(ge=1, description="times as far as by palpated markers the axes of hinges may be off")
    reason: str = Field(min_length=1, description="what these figures rest on")

    @property
    def words(self) -> str:
        """For notes."""
        return (
            f"each coordinate is taken to err by {self.size_mm:g} mm for {self.memory_s:g} s at a time, joints "
            f"and axes of segments by {self.joints:g} times, hinges by {self.hinges:g} times what palpated markers "
            f"have; {self.reason}"
        )

    def least(self, rate: float) -> float:
        """m, noise of a frame below which none is believed, at a rate (Hz), that counts every frame as independent."""
        return 1e-3 * self.size_mm * max(self.memory_s * rate, 1.0) ** 0.5
