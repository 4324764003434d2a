"""A peer that is missing is a skipped test at home and a failure in CI."""

import sys

import pytest

from tests.export.peer_programs import peer


@pytest.mark.parametrize("name", ["mujoco", "opensim"])
def test_a_missing_peer_fails_in_ci(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, name, None)  # as if it were not installed
    monkeypatch.delenv("CI", raising=False)
    with pytest.raises(pytest.skip.Exception, match=f"no {name} here"):
        peer(name)
    monkeypatch.setenv("CI", "true")
    wanted = pytest.skip.Exception if name == "opensim" and sys.version_info < (3, 11) else pytest.fail.Exception
    with pytest.raises(wanted, match="extra `peers`"):
        peer(name)
