"""`fovea version`: print the installed version, in one line or as JSON."""

import click

from pipeline.cli.arguments import JSON, print_json
from pipeline.version import commit, described
from pipeline.version import version as installed


@click.command("version")
@JSON
def version(as_json: bool) -> None:
    """Print version and commit."""
    if as_json:
        print_json({"version": installed(), "commit": commit()})
    else:
        click.echo(f"fovea {described()}")
