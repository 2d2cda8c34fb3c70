"""Write docs/commands.md: the help text of every command, as `ninedtact COMMAND --help` prints it."""

import contextlib
import io
import os
import re
from pathlib import Path

os.environ["COLUMNS"] = "110"

PAGE = Path(__file__).parents[1] / "docs" / "commands.md"
HEADER = """# Commands

This page is made from the commands' own help texts by `scripts/write_command_reference.py`. `ninedtact COMMAND --help` prints
the same. Exit codes: 0 done, 1 the work failed and one line says why, 2 wrong usage. With `--json` a command prints one JSON
object in place of text for people.
"""


def command_reference() -> str:
    """Return the page."""
    sections = [f"## ninedtact {' '.join(words)}\n\n```text\n{help_text(*words)}\n```\n" for words in command_words()]
    return "\n".join([HEADER, *sections])


def command_words(*prefix: str) -> list[tuple[str, ...]]:
    """Return the words of every command, those of groups (`hardware export`) included, in the order of the help."""
    usage = help_text(*prefix).split("\n\n")[0]
    names = re.search(r"\] \{([a-z0-9,-]+)\}$", usage)
    if names is None:
        return [prefix]
    return [words for name in names[1].split(",") for words in command_words(*prefix, name)]


def help_text(*words: str) -> str:
    """Return what `ninedtact WORDS --help` prints, without colours."""
    from ninedtact.cli import main

    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.suppress(SystemExit):
        main([*words, "--help"])
    plain = re.sub(r"\x1b\[[0-9;]*m", "", printed.getvalue())
    return "\n".join(line.rstrip() for line in plain.splitlines()).rstrip()


if __name__ == "__main__":
    PAGE.write_text(command_reference(), encoding="utf-8")
    print(f"wrote {PAGE}")
