"""`fovea completion bash | zsh | fish`: the script by which a shell completes commands and graphs.

The script calls `fovea` again with the words so far; names of commands come without loading one.
"""

import click
from click.shell_completion import get_completion_class

SHELLS = ("bash", "zsh", "fish")
VARIABLE = "_FOVEA_COMPLETE"  # by which the script tells click that words are to be completed


@click.command()
@click.argument("shell", type=click.Choice(SHELLS))
@click.pass_context
def completion(context: click.Context, shell: str) -> None:
    """Print what completes words in a SHELL.

    \b
    bash:  eval "$(fovea completion bash)"            in ~/.bashrc
    zsh:   eval "$(fovea completion zsh)"             in ~/.zshrc
    fish:  fovea completion fish | source             in ~/.config/fish/config.fish
    """
    kind = get_completion_class(shell)
    assert kind is not None
    click.echo(kind(context.find_root().command, {}, "fovea", VARIABLE).source())
