"""Text for the terminal: safe to print, in the words of the command line, completed by the Tab key."""

from __future__ import annotations

import os
import re

import click
from click.shell_completion import CompletionItem

__all__ = ["complete_file", "complete_folder", "in_options", "one_line", "shown"]


_OPTIONS = {
    "(trial=...)": "(--trial)",
    "(time=...)": "(--time)",
    "time_unit is": "--time-unit is",
    "in time_unit and in units": "in --time-unit and in --units",
    "with time_unit": "with --time-unit",
    "with units": "with --units",
    "leave out time_unit": "leave out --time-unit",
    "time_unit and units": "--time-unit and --units",
    "units names": "--units names",
}
"""How errors name an argument in Python -> the option."""


def one_line(text: str) -> str:
    r"""Return the text on one line, without control characters: it may quote a hostile file name.

    Examples
    --------
    >>> one_line("first\n  second\x1b[31m")
    'first second [31m'
    """
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())


def shown(path: str | os.PathLike[str]) -> str:
    """Return a path as it can be printed."""
    return "".join(c if c.isprintable() else "?" for c in os.fspath(path))


def in_options(text: str) -> str:
    """Put the cures of errors, which name Python arguments, in terms of options.

    Examples
    --------
    >>> in_options("sort the rows, or give the column (trial=...)")
    'sort the rows, or give the column (--trial)'
    """
    for argument, option in _OPTIONS.items():
        text = text.replace(argument, option)
    return re.sub(r"coordinates=\{'(.+?)': '(.+?)'\}", r'--coordinates "\1=\2"', text)


def complete_file(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Let the shell complete the path of a file; a script of completions has nothing by default."""
    return [CompletionItem(incomplete, type="file")]


def complete_folder(ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
    """Let the shell complete the path of a directory."""
    return [CompletionItem(incomplete, type="dir")]
