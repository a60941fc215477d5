"""The common look of the three tools."""

import contextlib
import dataclasses
import functools
import gc
import inspect
import io
import math
import os
import re
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from types import ModuleType
from typing import Annotated, Any, NoReturn, TypeVar, get_type_hints

import typer
from typer.core import TyperCommand, TyperGroup

from drive_profiles.cli.completion import bash_words
from drive_profiles.cli.console import ExitStatus, Interrupts
from drive_profiles.cli.entry import came, exit_status, hear, interrupt, interrupted, leave
from drive_profiles.python_can import postpone_mf4

_WORD = re.compile(r"""(?:[^\s"']|"[^"]*"|'[^']*')+""")
_EXAMPLES = re.compile(r"^Examples?:[ \t]*", re.MULTILINE)
_LIST = re.compile(r"<list\[(\w+)\]>")
_BOUNDS = {"greater than or equal to": "at least", "less than or equal to": "at most", "greater than": "more than"}
_UNCUT = 10_000
_Command = TypeVar("_Command", bound=Callable[..., None])
_UNBROKEN = "\u2011"  # a hyphen after which no line ends
NEW_OBJECTS = 10_000
"""New objects after which Python looks for garbage; with its own 700, a start-up or a page spends a tenth of its time on that."""
READER_GONE = 141
"""Exit status where the reader of standard output has gone: 128 + SIGPIPE, as a shell gives it."""


def described(text: str) -> tuple[str, tuple[str, ...]]:
    """Split a command's help into its description, and the examples below `Examples:`."""
    description, *rest = _EXAMPLES.split(inspect.cleandoc(text), maxsplit=1)
    lines = "".join(rest).splitlines()
    return description.rstrip(), tuple(line.strip() for line in lines if line.strip())


def folded(command: str, width: int) -> list[str]:
    r"""Fold a command for the shell; each option stays with its value."""
    parts: list[str] = []
    for word in _WORD.findall(command):
        if parts and not word.startswith("-"):
            parts[-1] += f" {word}"
        else:
            parts.append(word)
    lines = parts[:1]
    for part in parts[1:]:
        room = width - 2  # for a backslash
        if len(lines[-1]) + 1 + len(part) <= (width if part is parts[-1] else room):
            lines[-1] += f" {part}"
        else:
            lines[-1] += " \\"
            lines.append(f"    {part}")
    return lines


def _without_types(left: str) -> str:
    """Take Python's types out of an argument or option in the help: `SET <list[Path]>`, `--axis <list[int]>`."""
    if not left.startswith("-"):
        return left.partition(" <")[0]
    return _LIST.sub(lambda found: f"<{found[1].lower()}>", left)


class _Help:
    """Help of a command or a group, whose examples are not wrapped."""

    help: str | None
    epilog: str | None

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write the help, with names such as `fixed-notch` unbroken, to copy them."""
        write_rows = formatter.write_dl
        formatter.write_dl = lambda rows, *sizes: write_rows(
            [(_without_types(left), right.replace("-", _UNBROKEN)) for left, right in rows], *sizes
        )
        super().format_help(ctx, formatter)  # type: ignore[misc]
        formatter.buffer[:] = [part.replace(_UNBROKEN, "-") for part in formatter.buffer]

    def format_help_text(self, ctx: Any, formatter: Any) -> None:
        """Write the description, the examples left out."""
        description, _ = described(self.help or "")
        if description:
            formatter.write_paragraph()
            with formatter.indentation():
                formatter.write_text(description)

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """Write the examples for the shell, and the exit statuses."""
        _, examples = described(self.help or "")
        if examples:
            with formatter.section("Examples"):
                for example in examples:
                    for line in folded(example, formatter.width - formatter.current_indent):
                        formatter.write(f"{'':>{formatter.current_indent}}{line}\n")
        if self.epilog:
            formatter.write_paragraph()
            formatter.write_text(self.epilog)


class ToolCommand(_Help, TyperCommand):
    """Command of a tool."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read the arguments; a refusal names value and expectation."""
        try:
            rest = super().parse_args(ctx, args)
            options: list[Any] = self.params
            for option in options:
                value = ctx.params.get(str(option.name))
                if isinstance(value, float) and not math.isfinite(value):
                    raise typer.BadParameter(f"'{value}': expected a finite number", ctx, option)
            return rest
        except typer.BadParameter as error:
            details: list[Any] = getattr(error.__cause__, "errors", list)()
            if details and details[0]["type"] != "value_error":  # a choice names the value itself
                expected = str(details[0]["msg"]).removeprefix("Input should be ").partition(", unable to")[0]
                for long, short in _BOUNDS.items():
                    expected = expected.replace(long, short)
                error.message = f"{details[0]['input']!r}: expected {expected}"
            elif details:
                error.message = str(details[0]["msg"]).removeprefix("Value error, ")
            raise


class ToolGroup(_Help, TyperGroup):
    """Tool, or group of its commands, whose summaries are whole sentences."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command; end quietly if the output's reader is gone."""
        try:
            with _interruptible():
                return super().invoke(ctx)
        except BrokenPipeError:
            os._exit(READER_GONE)

    def make_context(self, *arguments: Any, **named: Any) -> Any:
        """Read the arguments of the tool, for which modules may load."""
        with _interruptible():
            return super().make_context(*arguments, **named)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands with their summaries."""
        commands = [(name, self.commands[name]) for name in self.list_commands(ctx)]
        rows = [(name, command.get_short_help_str(_UNCUT)) for name, command in commands if not command.hidden]
        if rows:
            with formatter.section("Commands"):
                formatter.write_dl(rows)


@contextlib.contextmanager
def _interruptible() -> Iterator[None]:
    """End with a line after an interrupt; click would end without one."""
    try:
        yield
    except KeyboardInterrupt as error:
        typer.echo(interrupted(error), err=True)
        raise typer.Exit(ExitStatus.INTERRUPTED) from None


class Tool(typer.Typer):
    """Application of a tool, or a group of commands inside of one."""

    def __init__(self, name: str, help: str, epilog: str | None = None, *, is_group: bool = False) -> None:
        super().__init__(
            name=name,
            cls=ToolGroup,
            help=help,
            epilog=epilog,
            no_args_is_help=True,
            add_completion=not is_group,
            rich_markup_mode=None,  # plain: brackets are text, and a copied line has no frame
            pretty_exceptions_enable=False,
        )
        if not is_group:
            self.callback(help=help)(_root)

    def command(self, name: str | None = None, **settings: Any) -> Callable[[Any], Any]:
        """Return a decorator that adds a command, a `ToolCommand` by default.

        A parameter that is a dataclass stands for its fields: the required ones at its place, the others after all parameters.
        """
        add = super().command(name, **({"cls": ToolCommand} | settings))
        return lambda function: add(_with_fields(function))

    def run(self, arguments: Sequence[str] | None = None) -> None:
        """Run the tool; never returns."""
        postpone_mf4()
        os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # a search of all installed packages, in 40 ms
        gc.set_threshold(NEW_OBJECTS)
        Interrupts.owns_process = True
        hear(interrupt)
        if isinstance(sys.stdout, io.TextIOWrapper) and sys.stdout.errors == "strict":
            sys.stdout.reconfigure(errors="backslashreplace")  # a code page, as of a file on Windows, lacks most characters
        try:
            with bash_words():
                self(None if arguments is None else [*arguments])
        except SystemExit as end:
            if not Interrupts.is_held_to_the_end:
                raise
            _leave(end.code if isinstance(end.code, int) else 0)
        except Exception:
            if not came:
                raise
            # an extension module may wrap an interrupt in an error of its own, as pydantic does while it builds a schema
            leave("interrupted\n", exit_status())


_declared: defaultdict[str, list[tuple[Callable[..., None], str | None, dict[str, Any]]]] = defaultdict(list)
"""Commands of each module, in their order, with their names and settings."""


def command(name: str | None = None, **settings: Any) -> Callable[[_Command], _Command]:
    """Return a decorator that declares a command of its module, for `mount`."""

    def declare(function: _Command) -> _Command:
        _declared[function.__module__].append((function, name, settings))
        return function

    return declare


def _with_fields(function: Callable[..., None]) -> Callable[..., None]:
    """Return a command with an option for each field of a dataclass."""
    parameters: list[inspect.Parameter] = []
    behind: list[inspect.Parameter] = []
    groups: dict[str, tuple[Any, list[str]]] = {}
    for each in inspect.signature(function, eval_str=True).parameters.values():
        group: Any = each.annotation
        if not dataclasses.is_dataclass(group):
            parameters.append(each.replace(kind=inspect.Parameter.KEYWORD_ONLY))
            continue
        hints = get_type_hints(group, include_extras=True)
        groups[each.name] = group, [field.name for field in dataclasses.fields(group)]
        for field in dataclasses.fields(group):
            is_required = field.default is dataclasses.MISSING
            default = inspect.Parameter.empty if is_required else field.default
            option = inspect.Parameter(field.name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=hints[field.name])
            (parameters if is_required else behind).append(option)

    @functools.wraps(function)
    def flat(**values: Any) -> None:
        made = {name: group(**{field: values.pop(field) for field in fields}) for name, (group, fields) in groups.items()}
        function(**made, **values)

    flat.__dict__["__signature__"] = inspect.Signature([*parameters, *behind])
    flat.__annotations__ = {each.name: each.annotation for each in (*parameters, *behind)}
    return flat if groups else function


def mount(app: Tool, *modules: ModuleType) -> None:
    """Add the commands of modules, and the groups that are theirs, to an application."""
    for module in modules:
        for function, name, settings in _declared[module.__name__]:
            app.command(name, **settings)(function)
        for group in vars(module).values():
            if isinstance(group, Tool):
                app.add_typer(group)


def _leave(status: int) -> NoReturn:
    """End the process at once; a usual end would handle signals again."""
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()
    os._exit(status)


def _print_version(value: bool) -> None:
    if value:
        from drive_profiles.version import DISTRIBUTION, version_text  # only here

        typer.echo(f"{DISTRIBUTION} {version_text()}")
        raise typer.Exit


VersionOption = Annotated[
    bool, typer.Option("--version", help="Print version and commit.", callback=_print_version, is_eager=True)
]


def _root(*, version: VersionOption = False) -> None:
    pass
