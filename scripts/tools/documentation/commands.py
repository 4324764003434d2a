"""Commands and options, as the program itself tells them."""

from __future__ import annotations

import inspect
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, get_args

from typer.models import ArgumentInfo, OptionInfo

from gaitcal.cli.application import COMMANDS, HELP, declared
from scripts.tools.documentation.tables import table_of

EVERYWHERE: Final = ("--quiet", "--verbose", "--help")
"""Options that every command has, told once."""


@dataclass(frozen=True, kw_only=True)
class Parameter:
    names: tuple[str, ...]
    """As they are typed: `--jobs`; of an argument its word in the usage, `DIR`."""
    takes: str
    """Words for its value; empty for a switch."""
    default: str
    required: bool
    argument: bool
    text: str


@dataclass(frozen=True)
class Command:
    name: str
    text: str
    example: str
    parameters: tuple[Parameter, ...]

    @property
    def usage(self) -> str:
        """`gaitcal check STUDY [options]`."""
        words = [p.names[0] for p in self.parameters if p.argument]
        needed = [f"{p.names[0]} {p.takes}" for p in self.parameters if p.required and not p.argument]
        return " ".join(("gaitcal", self.name, *words, *needed, "[options]"))


def _value(kind: object, info: OptionInfo) -> str:
    """What an option takes: its own word, or one of its type, with its range."""
    names = {int: "N", float: "NUMBER", Path: "PATH", str: "TEXT"}
    members = set(get_args(kind)) or {kind}
    word = info.metavar or next((word for of, word in names.items() if of in members or list[of] in members), "TEXT")
    if info.min is None and info.max is None:
        return word
    return f"{word} ({info.min:g} to {info.max:g})" if info.max is not None else f"{word} (≥ {info.min:g})"


def _parameter(name: str, annotation: Any, default: object) -> Parameter:
    kind, info = get_args(annotation)[:2]
    argument = isinstance(info, ArgumentInfo)
    flag = kind is bool
    needed = default is inspect.Parameter.empty
    dashed = "--" + name.replace("_", "-")
    declared = tuple(d for d in (info.default, *(info.param_decls or ())) if isinstance(d, str))  # typer, in Annotated
    names = (info.metavar or name.upper(),) if argument else declared or (dashed,)
    if flag and not argument and default is True:
        names = (dashed, dashed.replace("--", "--no-", 1))
    shown = not needed and default is not None and not (flag and default is False)
    return Parameter(
        names=tuple(names),
        takes="" if argument or flag else _value(kind, info),
        default=(f"{names[0]}" if flag else str(default)) if shown else "",
        required=needed,
        argument=argument,
        text=info.help or "",
    )


def commands() -> tuple[Command, ...]:
    out = []
    for name, (_, example) in COMMANDS.items():
        given = inspect.signature(declared(name)).parameters.values()
        parameters = tuple(_parameter(p.name, p.annotation, p.default) for p in given)
        out.append(Command(name, HELP[name], example, parameters))
    return tuple(out)


def options_of(command: Command) -> tuple[Parameter, ...]:
    return tuple(p for p in command.parameters if not set(p.names) & set(EVERYWHERE))


def _names(parameter: Parameter) -> str:
    first = [f"`{name}`" for name in parameter.names]
    if parameter.takes:
        first[0] = f"`{parameter.names[0]} {parameter.takes.split(' ')[0]}`"
    return ", ".join(first)


def markdown(name: str) -> str:
    """Usage, what it does, its example, and a table of its arguments and options."""
    command = next(c for c in commands() if c.name == name)
    lines = [f'```text title="usage"\n{command.usage}\n```', "", command.text, ""]
    if command.example:
        lines += [f'```text title="example"\n{command.example}\n```', ""]
    if own := options_of(command):
        lines.append(table_of(("argument or option", "unless given", "meaning"), map(_row, own)))
    return "\n".join(lines)


def _row(p: Parameter) -> tuple[str, str, str]:
    default = "needed" if p.required else (f"`{p.default}`" if p.default else "")
    return _names(p), default, f"{p.text} {p.takes.partition(' ')[2]}".strip()
