"""What is computed once is kept by the object that it is of, and by no other."""

from dataclasses import dataclass, replace

import pytest

from gaitcal.runtime import remembered


@dataclass(frozen=True)
class Person:
    """Somebody with a name."""

    name: str


calls: list[str] = []


@remembered
def greeting(of: Person) -> str:
    """Of a person."""
    calls.append(of.name)
    if not of.name:
        raise ValueError("nobody")
    return f"hello {of.name}"


def test_it_is_computed_once_for_each_object() -> None:
    calls.clear()
    ann = Person("Ann")
    assert [greeting(ann), greeting(ann)] == ["hello Ann"] * 2
    assert calls == ["Ann"]
    assert greeting(replace(ann, name="Bob")) == "hello Bob"
    assert greeting(ann) == "hello Ann"
    assert ann == Person("Ann")


def test_a_fault_is_raised_every_time() -> None:
    nobody = Person("")
    for _ in range(2):
        with pytest.raises(ValueError, match="nobody"):
            greeting(nobody)
