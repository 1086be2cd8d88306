"""`fovea completion bash | zsh | fish`: print a completion script for commands and graphs.

The script calls `fovea` with the words so far; completing a command's name loads no command.
"""

import click
from click.shell_completion import get_completion_class

SHELLS = ("bash", "zsh", "fish")
VARIABLE = "_FOVEA_COMPLETE"  # set by the script to request completion from click


@click.command()
@click.argument("shell", type=click.Choice(SHELLS))
@click.pass_context
def completion(context: click.Context, shell: str) -> None:
    """Print completion code for a SHELL.

    \b
    bash:  eval "$(fovea completion bash)"            in ~/.bashrc
    zsh:   eval "$(fovea completion zsh)"             in ~/.zshrc
    fish:  fovea completion fish | source             in ~/.config/fish/config.fish
    """
    kind = get_completion_class(shell)
    assert kind is not None
    click.echo(kind(context.find_root().command, {}, "fovea", VARIABLE).source())
