"""Programs that tests start hear signals, even where the tests are started with signals ignored."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
IGNORED = "import os, signal, sys; [signal.signal(int(n), signal.SIG_IGN) for n in sys.argv[1].split(',')]; "
CHILD = "import signal; print([signal.getsignal(n) is signal.SIG_IGN for n in (1, 2, 15)])"


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_children_hear_what_the_tests_ignore() -> None:
    code = f"""{IGNORED}
from tests.conftest import _let_children_hear
import subprocess
ask = [sys.executable, "-c", "{CHILD}"]
subprocess.run(ask)
_let_children_hear()
os.kill(os.getpid(), signal.SIGHUP)
sys.stdout.flush()
subprocess.run(ask)
"""
    done = subprocess.run(
        [sys.executable, "-c", code, "1,2,15"], cwd=ROOT, env=dict(os.environ), capture_output=True, text=True
    )
    assert done.stdout.splitlines() == [str([True] * 3), str([False] * 3)]
