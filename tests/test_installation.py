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


def test_the_distributions_hold_what_users_need_and_a_page_that_works_outside_the_repository(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "scripts"))
    from check_distributions import faults_of, main, read_distribution

    url = "https://example.org/maker/ninedtact"
    uv = shutil.which("uv", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")
    assert uv is not None
    command = [uv, "build", "-q", "--out-dir", str(tmp_path), str(ROOT)]
    if links := os.environ.get("UV_FIND_LINKS") or os.environ.get("PIP_FIND_LINKS"):
        command += ["--find-links", links]
    subprocess.run(command, check=True, env={**os.environ, "NINEDTACT_REPOSITORY_URL": url})
    assert main(str(tmp_path)) == 0, capsys.readouterr().out
    (wheel,) = tmp_path.glob("*.whl")
    files = read_distribution(wheel)
    metadata = next(data for name, data in files.items() if name.endswith("/METADATA")).decode()
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert f"({url}/raw/v{version}/docs/images/ball_shaded.png)" in metadata
    for path in re.findall(rf"\({re.escape(url)}/(?:raw|blob)/v{re.escape(version)}/([^)]+)\)", metadata):
        assert (ROOT / path).exists(), path
    with zipfile.ZipFile(wheel, "w") as worse:
        for name, data in (files | {"tests/test_x.py": b"", "ninedtact/press.mcap": str(ROOT).encode()}).items():
            if name != "ninedtact/force/shipped.onnx":
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
