"""The program ``halfshaft``: the command line, interruptible from its first import on."""

import sys


def main() -> None:
    """Run the command line."""
    try:
        from halfshaft.app.cli import app

        app()
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)  # noqa: T201
        sys.exit(130)


if __name__ == "__main__":
    main()
