"""What is installed: the lock file for development, the licences of what users load, and the distributions."""

import os
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
PROJECTS = [tomllib.loads(path.read_text())["project"] for path in sorted(ROOT.glob("packages/*/pyproject.toml"))]
LOCKED_EXTRAS = ("studio", "training")


def test_the_lock_file_fits_what_is_declared_and_names_no_machine() -> None:
    text = (ROOT / "requirements-dev.lock").read_text()
    assert not re.search(r"://|@ |--|\+|\.\./|(?<!\S)/", text)  # addresses, options, builds and paths
    locked = dict(re.findall(r"^([a-z0-9.-]+)==([^\s;]+)", text, re.MULTILINE))
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["dependency-groups"]["dev"]
    for project in PROJECTS:
        declared += project["dependencies"]
        declared += (one for name in LOCKED_EXTRAS for one in project.get("optional-dependencies", {}).get(name, ()))
    for requirement in map(Requirement, declared):
        if requirement.name.startswith("ninedtact"):
            continue
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


def test_the_distributions_have_one_version_and_hold_what_users_need(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "scripts"))
    from check_distributions import faults_of, main, read_distribution

    (version,) = {project["version"] for project in PROJECTS}
    siblings = [text for project in PROJECTS for text in re.findall(r"ninedtact[^'\"]*==([^'\"]+)", str(project))]
    assert siblings and set(siblings) == {version}
    uv = shutil.which("uv", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    assert uv is not None
    links = os.environ.get("UV_FIND_LINKS") or os.environ.get("PIP_FIND_LINKS")
    for project in PROJECTS:
        command = [uv, "build", "-q", "--out-dir", str(tmp_path), str(ROOT / "packages" / project["name"])]
        subprocess.run([*command, "--find-links", links] if links else command, check=True)
    assert main(str(tmp_path)) == 0, capsys.readouterr().out
    (wheel,) = tmp_path.glob("ninedtact-*.whl")
    files = read_distribution(wheel)
    with zipfile.ZipFile(wheel, "w") as worse:
        for name, data in (files | {"tests/test_x.py": b"", "ninedtact/press.mcap": str(ROOT).encode()}).items():
            if name != "ninedtact/_version.py":
                worse.writestr(name, data)
    assert len(faults_of(wheel)) == 4  # a missing file, two that are foreign, and a folder of this machine


def test_the_release_workflow_is_started_by_people_and_stores_no_password() -> None:
    release = (ROOT / ".github" / "workflows" / "release.yml").read_text()
    workflow = yaml.safe_load(release)
    assert set(workflow[True]) == {"push", "workflow_dispatch"} and workflow[True]["push"] == {"tags": ["v*"]}
    assert workflow["jobs"]["publish"]["permissions"] == {"id-token": "write"}
    assert "make dist" in [step.get("run") for step in workflow["jobs"]["build"]["steps"]]
    assert "secrets." not in release and "password" not in yaml.dump(workflow)


def test_nothing_is_published_unless_tests_interoperation_and_documentation_pass() -> None:
    release, checks = (
        yaml.safe_load((ROOT / f".github/workflows/{name}.yml").read_text()) for name in ("release", "checks")
    )
    assert set(release["jobs"]["publish"]["needs"]) == {"checks", "build"}
    assert release["jobs"]["checks"] == {"uses": "./.github/workflows/checks.yml"}
    assert set(checks[True]) == {"push", "pull_request", "workflow_call"}
    ran = " ".join(step.get("run", "") for job in checks["jobs"].values() for step in job["steps"])
    assert ".ci/run" in ran and "make test-interop" in ran and "make docs" in ran
    assert "\nmake test\n" in (ROOT / ".ci/run").read_text()
    assert not any({"if", "continue-on-error"} & set(job) for job in checks["jobs"].values())
