"""The command line. Each group of commands has its module, imported only when it is used."""

from __future__ import annotations

import importlib
from importlib.metadata import entry_points

import click

from uwserver import __version__
from uwserver.ports.checks import suggestion

_WHERE = {
    "run": "run",
    "check": "scenario",
    "schema": "scenario",
    "list": "scenario",
    "new": "authoring",
    "show": "authoring",
    "copy": "authoring",
    "replay": "replay",
    "play": "play",
    "log": "log",
    "export": "export",
    "compare": "compare",
    "record": "record",
    "plot": "plot",
    "shot": "shot",
    "validate": "validate",
    "manoeuvres": "manoeuvres",
    "camera-info": "camera_info",
    "doctor": "doctor",
}
_ELSEWHERE = {"bench": "uwserver-bench"}
"""Commands of other distributions, found by their entry point in the group ``uwserver.commands``."""


class _Lazy(click.Group):
    """Finds a command in its module when it is asked for: `uwserver list` need not load the server."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return [*_WHERE, *_ELSEWHERE]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name in _ELSEWHERE:
            return _elsewhere(cmd_name)
        if cmd_name not in _WHERE:
            return None
        module = importlib.import_module(f"uwserver.cli.{_WHERE[cmd_name]}")
        found: click.Command = next(command for command in module.COMMANDS if command.name == cmd_name)
        return found

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        known = self.list_commands(ctx)
        if args and args[0] not in known:
            ctx.fail(f'no command "{args[0]}"{suggestion(args[0], known)}; there are: {", ".join(known)}')
        return super().resolve_command(ctx, args)


def _elsewhere(name: str) -> click.Command:
    """The command of another distribution; one that says what to install, when that is missing or does not load."""
    package = _ELSEWHERE[name]
    fault = "it is not installed"
    for entry in entry_points(group="uwserver.commands", name=name):
        try:
            command: click.Command = entry.load()
        except ImportError as error:
            fault = f"it does not load ({error})"
        else:
            return command
    text = f"{fault}: pip install {package} (in a checkout of the sources: pip install ./{name})"

    def refuse(**_: object) -> None:
        raise click.ClickException(f"uwserver {name}: {text}")

    takes_all = {"ignore_unknown_options": True, "allow_extra_args": True, "help_option_names": []}
    return click.Command(
        name, context_settings=takes_all, callback=refuse, short_help=f"(needs: pip install {package})"
    )


@click.group(cls=_Lazy, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="uwserver")
def main() -> None:
    """Headless co-simulation server for underwater robots."""
