"""Write docs/commands.md from the help texts of the commands: what each is for, an example, and its options.

An option that has the same text in several commands is explained once, at the top of the page.
"""

import contextlib
import io
import os
import re
import textwrap
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

os.environ["COLUMNS"] = "110"

PAGE = Path(__file__).parents[1] / "docs" / "commands.md"
HEADER = """# Commands

What each command is for, one usual call, and its options in a few words; `ninedtact COMMAND --help` prints all of it. Exit codes:
0 done, 1 the work failed and one line says why, 2 wrong usage. `scripts/write_command_reference.py` makes this page.
"""
EXAMPLES = {
    "demo": "--sensor my_sensor",
    "calibrate": "--out my_sensor --source 0",
    "reconstruct": "--sensor my_sensor --reference reference.png press.png --out results",
    "check": "--sensor my_sensor today.png",
    "compare": "left right --out both.html",
    "live": "--sensor my_sensor --source 0 --force physics",
    "play": "press.mcap",
    "ros2": "--sensor my_sensor --source 0",
    "foxglove": "--sensor my_sensor --source 0 --layout layout.json",
    "serve": "--sensor my_sensor --source 0",
    "simulate fit": "--sensor my_sensor",
    "simulate press": "--object gear_07 --load-n 10 --out out/gear",
    "simulate objects": "",
    "simulate dataset": "--out pairs --pairs 10000 --sensors 20 --objects 175",
    "simulate sequences": "--out sequences --sequences 160 --sensors 20",
    "collect": "--sensor my_sensor --source 0 --force-torque netft:192.168.1.1 --out pairs.mcap",
    "record": "--sensor my_sensor --source 0 --force physics --out press.mcap",
    "info": "press.mcap",
    "export": "press.mcap --out press",
    "dataset build": "--out pairs monday.mcap lab=/data/Dataset",
    "dataset check": "pairs",
    "dataset show": "pairs",
    "import-calibration": "calibration/sensor_1 --out imported",
    "export-calibration": "--sensor my_sensor --out calibration/sensor_1",
    "track": "press.mcap --out path.csv",
    "train": "--data pairs --out training",
    "model card": "--model training/model.onnx",
    "model make": "--out first",
    "estimate": "--sensor my_sensor --reference reference.png press.png",
    "adapt": "--sensor my_sensor --reference reference.png --press a.png 52 --press b.png 198",
    "evaluate": "--data pairs --force physics",
    "hardware export": "--out parts",
    "hardware bom": "",
    "hardware check": "--design my_design.toml",
    "hardware explore": "--gel-mm 1.5 2.5 4",
    "hardware guide": "--out guide",
    "camera-delay": "--source usb:1-2 --sensor my_sensor",
    "doctor": "",
}
"""Arguments of one usual call of every command; the tests parse them."""


MANY_NUMBERS = 6
"""Options that are numbers with a default, from which on a command's are listed with their defaults alone."""


@dataclass(frozen=True)
class CommandOption:
    """One argument of a command: how it is written, what the help says of it, and its default or that it is required."""

    flags: str
    text: str
    note: str

    @property
    def name(self) -> str:
        """The option without the kind of its value."""
        return self.flags.split()[0]

    @property
    def meaning(self) -> tuple[str, str]:
        """The name and the text, which several commands may share, also where some take several values."""
        return self.name, self.gist()

    @property
    def is_number(self) -> bool:
        """Whether the option is a number that has a default."""
        return "FLOAT" in self.flags and self.note.startswith("(default")

    def entry(self, with_note: bool) -> str:
        """Return the lines of this option in a block: how it is written, what it is for, and perhaps its note."""
        said = " ".join(part for part in (self.gist(), self.note if with_note else "") if part)
        return textwrap.fill(f"{self.flags}  {said}", 108, subsequent_indent="      ", break_on_hyphens=False)

    def gist(self) -> str:
        """Return the help up to the end of its first clause.

        All of it is returned where the last sentence says that the option switches something off, or where it explains choices.
        """
        if self.name.startswith("--no-") or re.search(r"[{,](\w+)[,}].*\b\1: ", f"{self.flags} {self.text}"):
            return self.text
        clause = re.split(r"(?:(?<!\.)\.(?= [A-Z`])|; )(?![^(]*\))", self.text, maxsplit=1)[0].rstrip(".")
        clause = re.split(r", (?:which|whose) (?![^(]*\))", clause, maxsplit=1)[0]
        if len(clause.split()) < 3:
            return self.text
        head = re.split(r": (?![^(]*\))", clause, maxsplit=1)[0]
        return head if len(head.split()) > 5 else clause

    def mention(self) -> str:
        """Return the name with the default, for a list of names."""
        note = re.sub(r"\(default: (.*)\)", r"\1", self.note)
        return f"`{self.name}`{' ' + note if note else ''}"


def command_reference() -> str:
    """Return the page."""
    commands = {" ".join(words): help_text(*words) for words in command_words()}
    options = {name: command_options(text) for name, text in commands.items()}
    every = [one for each in options.values() for one in each if one.name.startswith("--") and "." not in one.name]
    uses = Counter(one.meaning for one in every)
    shared = {one.meaning: one.entry(False) for one in every if uses[one.meaning] > 1}
    listed = "\n".join(sorted(shared.values()))
    sections = [command_section(name, commands[name], options[name], shared) for name in commands]
    return "\n".join([HEADER, f"## Shared options\n\n```text\n{listed}\n```\n", *sections])


def command_section(name: str, text: str, options: list[CommandOption], shared: dict[tuple[str, str], str]) -> str:
    """Return the part of the page about one command."""
    purpose = text.split("\n\n")[1].strip()
    has_many = sum(one.is_number for one in options) >= MANY_NUMBERS
    lists = {
        "Settings and their defaults": [one for one in options if "." in one.name or (has_many and one.is_number)],
        "[Shared](#shared-options)": [one for one in options if one.meaning in shared],
    }
    settings, rest = lists.values()
    rest[:] = [one for one in rest if one not in settings]
    own = [one for one in options if not any(one in each for each in lists.values())]
    lines = [f"## ninedtact {name}", "", purpose, "", f"    ninedtact {name} {EXAMPLES[name]}".rstrip(), ""]
    if own:
        lines += ["```text", *(one.entry(True) for one in own), "```", ""]
    for title, found in lists.items():
        if found:
            listed = f"{title}: {', '.join(one.mention() for one in found)}."
            lines += [textwrap.fill(listed, 128, break_on_hyphens=False), ""]
    return "\n".join(lines)


def command_options(text: str) -> list[CommandOption]:
    """Return the arguments that a help text lists, without the help itself."""
    found = list[list[str]]()
    for line in text.split("\n\n ", 1)[-1].splitlines():
        if re.match(r"  \S", line) and not re.match(r"  -{9}", line):
            found.append([line.strip()])
        elif re.match(r" {4,}\S", line) and found:
            found[-1].append(line.strip())
    options = []
    for first, *rest in found:
        flags, _, begin = first.partition("  ")
        if not re.match(r"(--|-h|[A-Z]+( \.\.\.)?$)", flags):
            continue  # the sentence about a group of options
        said = " ".join([begin.strip(), *rest]).strip()
        note = re.search(r" ?\((required|repeatable|default: [^()]*)\)$", said)
        flags = re.sub(r"(FLOAT)((?: FLOAT)+)", lambda many: f"FLOAT x{len(many[0].split())}", flags)
        options.append(CommandOption(flags, said[: note.start()] if note else said, note[0].strip() if note else ""))
    return [one for one in options if not one.flags.startswith("-h")]


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
