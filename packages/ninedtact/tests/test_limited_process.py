"""What strangers' files cost is limited, and errors arrive as they were raised."""

import sys
import time
from pathlib import Path

import pytest

from ninedtact import limited_process
from ninedtact.errors import InputError
from ninedtact.limited_process import FileTooCostly, run_limited
from ninedtact.recording.metadata import RecordingMetadata
from ninedtact.simulation.objects.mesh_objects import MeshUnusable, load_mesh_object


def test_results_and_errors_arrive_from_the_process() -> None:
    assert run_limited(divmod, 7, 2, file_bytes=0) == (3, 1)
    with pytest.raises(InputError, match="expected a, got b; c"):
        raise run_limited(InputError, "expected a, got b; c", file_bytes=0)
    with pytest.raises(ZeroDivisionError):
        run_limited(divmod, 7, 0, file_bytes=0)
    assert run_limited(RecordingMetadata, "one", file_bytes=0).sensor == "one"


def test_memory_and_time_are_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limited_process, "_LEAST_S", 1.0)
    with pytest.raises(FileTooCostly):
        run_limited(bytes, 2_000_000_000, file_bytes=100)
    with pytest.raises(FileTooCostly):
        run_limited(pow, 3, 10**9, file_bytes=100)


@pytest.mark.skipif(sys.platform == "win32", reason="processor time is limited by the system elsewhere")
def test_what_a_busy_computer_does_late_is_no_cost_of_the_file(monkeypatch: pytest.MonkeyPatch) -> None:
    for limit in ("_LEAST_S", "_START_S"):
        monkeypatch.setattr(limited_process, limit, 1.0)
    assert run_limited(time.sleep, 2.5, file_bytes=0) is None


def test_an_obj_file_of_many_materials_is_read_within_its_limits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(limited_process, "_LEAST_S", 2.0)
    path, began_s = tmp_path / "materials.obj", time.monotonic()
    solid = "v -5 -5 3\nv 5 -5 3\nv 0 6 3\nv 0 0 0\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
    path.write_text(solid + "".join(f"usemtl m{number}\nf 1 2 3\n" for number in range(30_000)))
    try:
        load_mesh_object(path)
    except MeshUnusable as refusal:
        assert "simplify" in str(refusal)
    assert time.monotonic() - began_s < 13


@pytest.mark.parametrize("suffix", [".stl", ".obj"])
def test_a_small_plain_mesh_starts_no_process(suffix: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.icosphere(3, 5.0).export(tmp_path / f"ball{suffix}")
    monkeypatch.setattr(sys, "executable", str(tmp_path / "absent"))
    assert load_mesh_object(tmp_path / f"ball{suffix}").closed
