"""Frozen dataclasses that are quick to define.

The standard library writes six methods of each class as text and compiles them: half a millisecond a class, and of the
three hundred that a command loads a sixth of a second before it has read a file. Here what is alike in all classes is
written once, below, and a class's own `__init__` when it is first asked for. The rest is the standard library's,
also for a type checker. What no class here uses is refused: a field that is no argument or that hash or text leave out,
an `__init__` or `__setattr__` of its own, and parents or children that the standard library froze.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import MISSING, FrozenInstanceError
from reprlib import recursive_repr
from types import MethodType
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

_T = TypeVar("_T")


if TYPE_CHECKING:
    from dataclasses import dataclass as dataclass
else:

    def dataclass(*, frozen: bool, kw_only: bool = False) -> Callable[[type[_T]], type[_T]]:
        """`dataclasses.dataclass` of frozen classes."""
        if not frozen:
            raise TypeError("only frozen classes are alike: take the standard library's")

        def made(cls: type[_T]) -> type[_T]:
            if own := {"__init__", "__setattr__", "__delattr__"} & set(vars(cls)):
                raise TypeError(f"{cls.__name__} has {', '.join(sorted(own))}: take the standard library's dataclass")
            cls.__doc__ = cls.__doc__ or cls.__name__  # else the standard library describes its parameters there
            out = dataclasses.dataclass(init=False, repr=False, eq=False, kw_only=kw_only)(cls)
            out.__init__ = _Init(out)
            out.__setattr__, out.__delattr__ = _assigned, _deleted
            for name, method in _METHODS.items():
                if vars(out).get(name) is None:  # Python sets None for the hash of a class that compares by itself
                    setattr(out, name, method)
            return out

        return made


class _Factory:
    """The default of a field that is made anew for every object."""

    def __repr__(self) -> str:
        return "<factory>"


class _Init:
    """Stands for the `__init__` of a class until somebody asks for it."""

    def __init__(self, of: type) -> None:
        self.of = of

    def __get__(self, made: object | None, _: type | None = None) -> Callable[..., None]:
        init = _init_of(self.of)
        self.of.__init__ = init  # type: ignore[misc]
        return init if made is None else MethodType(init, made)


def _init_of(cls: type) -> Callable[..., None]:
    """`def __init__(self, a, b=default, *, c=default)` of the fields, which go past `__setattr__`."""
    known: dict[str, Any] = {"_NOT_GIVEN": _Factory()}
    by_place, by_name = ["self"], list[str]()
    body = ["    _of = self.__dict__"]
    for field in dataclasses.fields(cls):
        if not field.init or not field.repr or field.hash is not None:
            raise TypeError(f"field {field.name!r} of {cls.__name__}: take the standard library's dataclass")
        parameter = value = field.name
        if field.default is not MISSING:
            known[f"_default_{field.name}"] = field.default
            parameter += f"=_default_{field.name}"
        elif field.default_factory is not MISSING:
            known[f"_new_{field.name}"] = field.default_factory
            parameter += "=_NOT_GIVEN"
            value = f"_new_{field.name}() if {field.name} is _NOT_GIVEN else {field.name}"
        (by_name if field.kw_only else by_place).append(parameter)
        body.append(f"    _of['{field.name}'] = {value}")
    if hasattr(cls, "__post_init__"):
        body.append("    self.__post_init__()")
    parameters = ", ".join([*by_place, *(["*", *by_name] if by_name else [])])
    exec("\n".join([f"def __init__({parameters}):", *body]), known)
    init: Callable[..., None] = known["__init__"]
    init.__qualname__, init.__module__ = f"{cls.__qualname__}.__init__", cls.__module__
    init.__annotations__ = {field.name: field.type for field in dataclasses.fields(cls)} | {"return": None}
    return init


def _assigned(self: object, name: str, value: object) -> NoReturn:
    raise FrozenInstanceError(f"cannot assign to field {name!r}")


def _deleted(self: object, name: str) -> NoReturn:
    raise FrozenInstanceError(f"cannot delete field {name!r}")


def _compared(self: Any) -> tuple[Any, ...]:
    return tuple(getattr(self, field.name) for field in dataclasses.fields(self) if field.compare)


def _equal(self: Any, other: object) -> Any:
    return _compared(self) == _compared(other) if other.__class__ is self.__class__ else NotImplemented


def _hash(self: Any) -> int:
    return hash(_compared(self))


@recursive_repr()
def _repr(self: Any) -> str:
    values = ", ".join(f"{field.name}={getattr(self, field.name)!r}" for field in dataclasses.fields(self))
    return f"{self.__class__.__qualname__}({values})"


_METHODS: dict[str, Callable[..., Any]] = {"__eq__": _equal, "__hash__": _hash, "__repr__": _repr}
