"""Member `vendors`: unit and sign are found, strides counted by leg, a real walk agrees with its
vendor.
"""

import re
from pathlib import Path

import pytest

from scripts.validation.harness import results

WORSE = 1.3
"""Times: frames that the leg's rule adds may be so much further from the vendor's than all of them
(they are 0.8).
"""


def test_the_leg_of_a_real_walk_keeps_its_stride_and_agrees_with_the_vendor(
    data_dir: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The other foot stands beside all plates at both ends of this stance, and knows
    nothing of it.
    """
    results("vendors", "--only", "kad")
    said = capsys.readouterr().out
    assert "moments in N·mm/kg, internal" in said
    assert "throughout valid 0 by the whole body's rule, 1 by the leg's" in said
    stance, whole, leg = map(
        int, re.findall(r"stances on a plate: (\d+); valid (\d+) .* rule, (\d+)", said)[0]
    )
    assert whole < 0.6 * stance and leg == stance
    for row in re.findall(r"moment +-?1 +(\S+) +(\S+) +(\S+) +(\S+)", said):
        of_leg, new, correlation = map(float, row[1:])
        assert new < WORSE * of_leg and correlation > 0.9
    powers = re.findall(r"(hip|knee|ankle) power +(\S+) +\S+ +(\S+) +\S+ +(\S+) +28, 77", said)
    assert [joint for joint, *_ in powers] == ["hip", "knee", "ankle"]
    for _, sign, of_leg, correlation in powers:
        assert float(sign) == 1.0 and float(of_leg) < 0.2 and float(correlation) > 0.9, "W/kg"
    for name in (
        "hip_rotation",
        "knee_rotation",
    ):  # the vendor tells its moments in the distal segment
        proximal, r, distal, r_distal = map(float, re.findall(name + 4 * r" +([\d.]+)", said)[0])
        assert distal < 0.03 < 0.06 < proximal and r < 0.6 < 0.9 < r_distal
