"""The command line. The module of a command is imported only when the command is used."""

from __future__ import annotations

import os
import pkgutil
from importlib.metadata import entry_points

import click

from uwserver.physics.kernel.choice import VARIABLE, is_plain
from uwserver.ports.checks import suggestion
from uwserver.version import __version__

_COMMANDS = {
    "run": "serving.run:run",
    "check": "scenarios.check:check",
    "schema": "scenarios.listing:schema",
    "list": "scenarios.listing:list_",
    "new": "scenarios.authoring:new",
    "show": "scenarios.authoring:show",
    "copy": "scenarios.authoring:copy",
    "replay": "recordings.replay:replay",
    "play": "serving.play:play",
    "log": "recordings.log:log_command",
    "export": "recordings.export:export",
    "compare": "recordings.compare:compare",
    "record": "recordings.record:record",
    "plot": "recordings.plot:plot",
    "shot": "browser.shot:shot",
    "validate": "validation:validate",
    "manoeuvres": "validation:manoeuvres",
    "camera-info": "scenarios.listing:camera_info",
    "doctor": "doctor:doctor",
}
"""The module below `uwserver.cli` and the function of each command, in the order in which help lists them."""
_OTHER_DISTRIBUTIONS = {"bench": "uwserver-bench"}
"""Commands of other distributions, which are found by their entry point in the group ``uwserver.commands``."""


class _Commands(click.Group):
    """Imports a command when it is asked for, so that `uwserver list`, for example, need not load the server."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return [*_COMMANDS, *_OTHER_DISTRIBUTIONS]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name in _OTHER_DISTRIBUTIONS:
            return _command_of_distribution(cmd_name)
        if cmd_name not in _COMMANDS:
            return None
        if cmd_name != "doctor":  # which tells it among its findings
            _check_kernels()
        command: click.Command = pkgutil.resolve_name(f"uwserver.cli.{_COMMANDS[cmd_name]}")
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        known = self.list_commands(ctx)
        if args and args[0] not in known:
            # Imported here because it takes a moment, and most commands exist.
            from uwserver.scenario.files.words import translation

            hint = translation(args[0], known) or suggestion(args[0], known)
            ctx.fail(f'no command "{args[0]}"{hint}; there are: {", ".join(known)}')
        return super().resolve_command(ctx, args)


def _check_kernels() -> None:
    """Raise a ClickException if the choice of kernels in the environment is unknown: importing a kernel would be an error."""
    try:
        is_plain(os.environ.get(VARIABLE))
    except ValueError as error:
        raise click.ClickException(str(error)) from error


def _command_of_distribution(name: str) -> click.Command:
    """Return the command of another distribution, or one that tells what to install if that is missing or does not load."""
    package = _OTHER_DISTRIBUTIONS[name]
    # Imported here because only this command needs it.
    from uwserver.packages import install_command

    fault = "it is not installed"
    for entry in entry_points(group="uwserver.commands", name=name):
        try:
            command: click.Command = entry.load()
        except ImportError as error:
            fault = f"it does not load ({error})"
        else:
            return command

    def refuse(**_: object) -> None:
        remedy = f"{install_command(package)} (in a checkout of the sources: {install_command(f'./{name}')})"
        raise click.ClickException(f"uwserver {name}: {fault}: {remedy}")

    takes_all = {"ignore_unknown_options": True, "allow_extra_args": True, "help_option_names": []}
    return click.Command(
        name, context_settings=takes_all, callback=refuse, short_help=f"(needs {package}, which is not installed)"
    )


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="uwserver")
def main() -> None:
    """Headless co-simulation server for underwater robots."""
