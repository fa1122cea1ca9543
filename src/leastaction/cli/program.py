"""The program: its commands, and what becomes of errors."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from typing import Any, NoReturn

import click
from click.shell_completion import ShellComplete, get_completion_class

from leastaction.cli import arm, demo, discover, generate, linkage, use
from leastaction.cli.failures import EXIT_CODES, PIPE_CLOSED, Interrupted, give_up
from leastaction.cli.show import say

__all__ = ["main", "program"]


class _Program(click.Group):
    """A group whose errors become one line on stderr and an exit code (see `failures`)."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        ctx.obj = list(args)  # for the report, which shows the command
        return super().parse_args(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        try:
            with warnings.catch_warnings():
                # What a user can act on is in the model's own warnings.
                if not sys.warnoptions:
                    warnings.simplefilter("ignore")
                return super().invoke(ctx)
        except KeyboardInterrupt:
            # click would add an empty line.
            raise Interrupted from None
        except BrokenPipeError:
            # Whoever read the output has gone; click would call that an error of exit code 1.
            raise Interrupted(PIPE_CLOSED) from None

    def main(self, args=None, prog_name=None, complete_var=None, standalone_mode=True, **extra: Any) -> Any:
        try:
            code = super().main(
                args, prog_name or "leastaction", complete_var, standalone_mode=False, **extra
            )
        except Exception as error:
            code = give_up(error)
        sys.exit(code)


@click.group(
    name="leastaction",
    cls=_Program,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="\b\nExit codes:\n"
    + "\n".join(f"  {code:<5}{meaning}" for code, meaning in EXIT_CODES.items())
    + "\n\n\b\nExample:\n  leastaction generate cart_spring_pendulum --noise 0.02 -o cart.csv",
)
@click.version_option(package_name="leastaction", message="%(prog)s %(version)s")
@click.pass_context
def program(ctx: click.Context) -> None:
    """Find the Lagrangian of a mechanical system from noisy measured coordinates."""
    if ctx.invoked_subcommand is None:
        click.echo(ctx.get_help())


@click.command(
    short_help="Open the local app in the browser.",
    epilog="""\b
Example:
  leastaction app --port 8200 --no-browser
""",
)
@click.option(
    "--port",
    type=click.IntRange(1024, 65535),
    metavar="PORT",
    help="Port on this computer. Default: the first free one from 8137.",
)
@click.option("--no-browser", is_flag=True, help="Print the address without opening the browser.")
def app(port: int | None, no_browser: bool) -> None:
    """Open the local app: from a table to a model in the browser.

    The app is reachable only from this computer, by a browser that has opened the printed address with its
    token, and loads nothing from elsewhere. End it with Ctrl-C. It needs pip install 'leastaction[app]'.
    """
    from leastaction.app import run

    try:
        run(port, not no_browser, lambda address: say(f"leastaction app: {address} (end it with Ctrl-C)"))
    except KeyboardInterrupt:
        say("ended")  # the usual way to end it


_COMPLETION_HELP = """Print the script that completes commands, options, choices and files with the Tab key.

\b
Install it once, then open a new shell:
  bash  echo 'eval "$(leastaction completion bash)"' >> ~/.bashrc
  zsh   echo 'eval "$(leastaction completion zsh)"' >> ~/.zshrc
  fish  leastaction completion fish > ~/.config/fish/completions/leastaction.fish

This needs bash 4.4 or newer. In zsh, put the line below compinit.
"""


@click.command(
    help=_COMPLETION_HELP,
    short_help="Print the script for shell completion.",
    epilog="\b\nExample:\n  leastaction completion bash",
)
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]), metavar="bash|zsh|fish")
def completion(shell: str) -> None:
    """Print the script that lets the Tab key complete."""
    script = get_completion_class(shell)
    assert script is not None, shell
    # Not the method of the class: that of bash runs the bash of this machine first, to look at its version.
    say(ShellComplete.source(script(program, {}, "leastaction", "_LEASTACTION_COMPLETE")))


for _command in (
    discover.discover,
    arm.arm,
    use.show,
    use.simulate,
    use.validate,
    use.export,
    linkage.linkage,
    generate.generate,
    demo.demo,
    app,
    completion,
):
    program.add_command(_command)


def main(args: Sequence[str] | None = None) -> NoReturn:
    """Run the program with `args` (default: those of the process) and exit."""
    for stream in (sys.stdout, sys.stderr):
        # A terminal or pipe that has no θ must not end the program.
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]
    program.main(args)
    raise AssertionError("program.main exits")
