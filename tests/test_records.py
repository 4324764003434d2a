"""Quickly defined dataclasses are those of the standard library, but for what they refuse."""

from __future__ import annotations

import copy
import dataclasses
import inspect
import pickle
from dataclasses import FrozenInstanceError, asdict, field, fields, replace
from functools import cached_property

import pytest

from gaitcal.records import dataclass


@dataclass(frozen=True)
class Point:
    """A place."""

    x: float
    y: float = 0.0
    note: str = field(default="", compare=False)

    @cached_property
    def double(self) -> float:
        return 2 * self.x


@dataclass(frozen=True, kw_only=True)
class Named(Point):
    name: str
    parts: dict[str, Named] = field(default_factory=dict)


@dataclass(frozen=True)
class OwnMethods:
    number: int

    def __post_init__(self) -> None:
        if self.number < 0:
            raise ValueError(f"found {self.number}")

    def __repr__(self) -> str:
        return "own"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, OwnMethods)

    def __hash__(self) -> int:
        return 1


@dataclasses.dataclass(frozen=True)
class Usual:
    x: float
    y: float = 0.0
    note: str = field(default="", compare=False)


def test_made_by_place_and_by_name_with_defaults() -> None:
    assert Point(1.0) == Point(x=1.0, y=0.0)
    one, other = Named(1.0, name="a"), Named(1.0, name="a")
    assert one.parts == {}
    assert one.parts is not other.parts
    assert [f.name for f in fields(one)] == ["x", "y", "note", "name", "parts"]


@pytest.mark.parametrize("values", [(), (1.0, 2.0, "", 3), (1.0, 2.0, "", "a")])
def test_wrong_arguments_are_type_errors(values: tuple[object, ...]) -> None:
    with pytest.raises(TypeError, match=r"Named.__init__\(\)"):
        Named(*values)  # type: ignore[call-arg,arg-type]


def test_wrong_words_of_a_call_are_those_of_the_standard_library() -> None:
    for arguments in ({}, {"x": 1.0, "z": 2.0}):
        with pytest.raises(TypeError) as ours:
            Point(**arguments)
        with pytest.raises(TypeError) as usual:
            Usual(**arguments)
        assert str(ours.value) == str(usual.value).replace("Usual", "Point")


def test_text_equality_and_hash_are_those_of_the_standard_library() -> None:
    assert repr(Point(1.0, 2.0, "n")) == repr(Usual(1.0, 2.0, "n")).replace("Usual", "Point")
    assert hash(Point(1.0, 2.0, "n")) == hash(Usual(1.0, 2.0))
    assert Point(1.0, note="a") == Point(1.0, note="b")
    assert Point(1.0) != Usual(1.0)
    assert Point(1.0) != Point(2.0)
    assert len({Point(1.0), Point(1.0), Point(2.0)}) == 2


def test_what_a_class_writes_itself_stays() -> None:
    assert repr(OwnMethods(1)) == "own"
    assert OwnMethods(1) == OwnMethods(2)
    assert hash(OwnMethods(3)) == 1
    with pytest.raises(ValueError, match="found -1"):
        OwnMethods(-1)


def test_nothing_is_assigned_or_deleted() -> None:
    point = Point(1.0)
    with pytest.raises(FrozenInstanceError, match="cannot assign to field 'x'"):
        point.x = 2.0  # type: ignore[misc]
    with pytest.raises(FrozenInstanceError, match="cannot delete field 'x'"):
        del point.x
    assert point.double == 2.0, "what is computed once is kept"


def test_copies_and_the_tools_of_the_standard_library() -> None:
    whole = Named(1.0, name="a", parts={"b": Named(2.0, name="b")})
    for same in (copy.copy(whole), copy.deepcopy(whole), pickle.loads(pickle.dumps(whole)), replace(whole)):
        assert same == whole
    assert replace(whole, x=3.0).x == 3.0
    assert asdict(whole)["parts"]["b"]["name"] == "b"
    match Point(1.0, 2.0):
        case Point(x, y):
            assert (x, y) == (1.0, 2.0)


def test_a_class_that_can_be_changed_is_refused() -> None:
    with pytest.raises(TypeError, match="only frozen"):
        dataclass(frozen=False)


def test_the_signature_is_told() -> None:
    @dataclass(frozen=True, kw_only=True)
    class Fresh:
        a: int
        b: str = "b"

    assert str(inspect.signature(Fresh)) == "(*, a: 'int', b: 'str' = 'b') -> None"


def test_a_class_below_that_is_no_dataclass() -> None:
    class Below(Point):
        pass

    assert Below(1.0).x == 1.0
    assert Below(1.0) != Point(1.0)


def test_its_arguments_are_told_with_types_and_defaults() -> None:
    @dataclasses.dataclass(frozen=True, kw_only=True)
    class UsualNamed(Usual):
        name: str
        parts: dict[str, Named] = field(default_factory=dict)

    assert str(inspect.signature(Named)) == str(inspect.signature(UsualNamed))
    assert Named.__init__.__module__ == __name__


def test_a_class_that_compares_by_itself_has_a_hash() -> None:
    @dataclass(frozen=True)
    class Compared:
        number: int

        def __eq__(self, other: object) -> bool:
            return isinstance(other, Compared) and other.number % 2 == self.number % 2

    assert Compared(1) == Compared(3)
    assert hash(Compared(1)) == hash((1,))


def test_what_it_does_not_do_is_refused() -> None:
    with pytest.raises(TypeError, match="__init__"):

        @dataclass(frozen=True)
        class Initialised:
            x: int

            def __init__(self) -> None:
                """Nothing."""

    @dataclass(frozen=True)
    class Hidden:
        x: int = field(default=1, repr=False)

    with pytest.raises(TypeError, match="field 'x' of Hidden"):
        Hidden()
