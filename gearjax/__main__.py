"""``gearjax`` and ``python -m gearjax``."""

from gearjax import stopping


def main() -> None:
    """Listen to Ctrl-C, then import the command line, which takes seconds, and run it."""
    stopping.listen()
    from gearjax.cli import main as command  # not before: Ctrl-C would show where the import was

    command()


if __name__ == "__main__":
    main()
