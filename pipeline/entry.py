"""Entry point of the command `fovea`: handles signals first, then loads the command line."""

from pipeline import output, signals


def main() -> None:
    """Load what a command needs, which takes a second, and run it."""
    signals.quit_at_once()
    output.guard()
    from pipeline import cli

    cli.main()


if __name__ == "__main__":
    main()
