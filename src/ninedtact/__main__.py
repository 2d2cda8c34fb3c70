"""`ninedtact` and `python -m ninedtact`: the command line, with Ctrl-C answered from the first moment on."""

import sys


def run() -> int:
    """Load and run the command line."""
    try:
        from ninedtact.cli import main
    except KeyboardInterrupt:
        print("ninedtact: stopped by Ctrl-C before it began; run the command again", file=sys.stderr)  # noqa: T201
        return 1
    return main()


if __name__ == "__main__":
    sys.exit(run())
