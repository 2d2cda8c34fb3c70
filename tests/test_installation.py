"""What is installed: the lock file for development, and the licences of what users load."""

import re
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
LOCKED_EXTRAS = ("studio", "train", "hardware", "dev")


def test_the_lock_file_fits_what_is_declared_and_names_no_machine() -> None:
    text = (ROOT / "requirements-dev.lock").read_text()
    assert not re.search(r"://|@ |--|\+|\.\./|(?<!\S)/", text)  # addresses, options, builds and paths
    locked = dict(re.findall(r"^([a-z0-9.-]+)==([^\s;]+)", text, re.MULTILINE))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    declared = [
        *project["dependencies"],
        *(one for name in LOCKED_EXTRAS for one in project["optional-dependencies"][name]),
    ]
    for requirement in map(Requirement, declared):
        assert locked[canonicalize_name(requirement.name)] in requirement.specifier, f"run `make lock`: {requirement}"


def test_no_library_at_run_time_demands_its_licence_of_programs(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "scripts"))
    from list_licences import forbids_other_licences, main

    assert main() == 0
    listed = capsys.readouterr().out
    assert re.search(r"^numpy +\S+ +BSD", listed, re.MULTILINE) and "pytest" not in listed
    for refused in ("GPLv3", "AGPL-3.0-only", "GNU General Public License v3 (GPLv3)", "MIT AND GPL-2.0-or-later"):
        assert forbids_other_licences(refused), refused
    for fine in ("LGPL-2.1", "GNU Lesser General Public License v3 (LGPLv3)", "GPL-2.0 OR MIT", "MPL-2.0", "any-OSI"):
        assert not forbids_other_licences(fine), fine
    assert not forbids_other_licences("BSD-3-Clause AND GPL-3.0-or-later WITH GCC-exception-3.1")
