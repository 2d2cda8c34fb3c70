"""Work on a local Dask cluster: the bytes of one process, also after a worker or the command was killed.

`make test-cluster` installs the libraries and runs these tests; `make test` leaves them out.
"""

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from time import monotonic, sleep
from typing import Any

import pytest

from ninedtact import __version__
from ninedtact.cli import main
from ninedtact.errors import DeviceError, InputError
from ninedtact.force.onnx_model import read_force_model
from ninedtact.parallel_jobs import CONNECT_TIMEOUT_S, connect_workers, require_workers, run_jobs
from ninedtact.recording.attached_sensor import read_folder_files

pytestmark = pytest.mark.cluster
GENERATE = """
import sys
from pathlib import Path
from ninedtact_train.dataset.generation.generate import generate_dataset
from ninedtact_train.dataset.generation.settings import GenerationSettings
from ninedtact.parallel_jobs import connect_workers
if __name__ == "__main__":
    settings = GenerationSettings(
        pairs=160, size=(64, 48), sensors=2, object_names=("ball:3", "cone"), pitch_mm=0.5, session_pairs=8, sessions_per_file=2
    )
    with connect_workers(1, sys.argv[2] if sys.argv[2:] else None) as workers:
        generate_dataset(Path(sys.argv[1]), settings, workers)
"""
"""Ten files of some seconds each."""


@dataclass(frozen=True)
class LocalCluster:
    """A cluster on this machine with two workers."""

    address: str
    worker_ids: Callable[[], list[int]]
    """Returns the ids of the processes that run jobs."""


@contextmanager
def processes(*commands: list[str], env: dict[str, str] | None = None, cwd: Path) -> Iterator[list[int]]:
    """Run commands in the background, and end them and their children."""
    with (cwd / "output.txt").open("ab") as output:
        options: dict[str, Any] = {"cwd": cwd, "env": {**os.environ, **(env or {})}, "start_new_session": True}
        running = [subprocess.Popen(command, stdout=output, stderr=output, **options) for command in commands]
    try:
        yield [one.pid for one in running]
    finally:
        for one in reversed(running):
            one.terminate()
            try:
                one.wait(15)
            except subprocess.TimeoutExpired:
                os.killpg(one.pid, signal.SIGKILL)
                one.wait()


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def wait_until(condition: Callable[[], Any], seconds: float = 90) -> Any:
    until = monotonic() + seconds
    while monotonic() < until:
        if found := condition():
            return found
        sleep(0.1)
    pytest.fail(f"expected it within {seconds} s, got nothing")


def is_open(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def is_worker(process: int) -> bool:
    """Whether a child of a nanny runs jobs; the other is a tracker of resources."""
    return b"resource_tracker" not in Path(f"/proc/{process}/cmdline").read_bytes()


def children(parent: int) -> list[int]:
    lists = Path(f"/proc/{parent}/task").glob("*/children")
    return [int(child) for path in lists for child in path.read_text().split()]


@contextmanager
def dask_cluster(cwd: Path, threads: int = 1, env: dict[str, str] | None = None) -> Iterator[LocalCluster]:
    port, dask = free_port(), [sys.executable, "-m", "dask"]
    address = f"127.0.0.1:{port}"
    scheduler = [*dask, "scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]
    worker = [*dask, "worker", address, "--nthreads", str(threads), "--no-dashboard", "--local-directory", str(cwd)]
    with processes(scheduler, cwd=cwd), processes(worker, worker, cwd=cwd, env=env) as nannies:
        wait_until(lambda: is_open(port))
        import distributed

        with distributed.Client(address) as client:
            client.wait_for_workers(2, timeout=90)

        def worker_ids() -> list[int]:
            return [child for nanny in nannies for child in children(nanny) if is_worker(child)]

        yield LocalCluster(address, worker_ids)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LocalCluster]:
    with dask_cluster(tmp_path_factory.mktemp("elsewhere")) as started:
        yield started


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What one process makes."""
    out = tmp_path_factory.mktemp("alone") / "pairs"
    subprocess.run([sys.executable, "-c", GENERATE, str(out)], check=True)
    return out


def start(out: Path, cluster: LocalCluster) -> "subprocess.Popen[str]":
    command = [sys.executable, "-c", GENERATE, str(out), cluster.address]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def wait_for_files(out: Path, job: "subprocess.Popen[str]") -> None:
    wait_until(lambda: list((out / "data").glob("train-*")) or job.poll() is not None, 240)


def test_a_killed_worker_is_replaced(cluster: LocalCluster, alone: Path, tmp_path: Path) -> None:
    job = start(tmp_path / "pairs", cluster)
    wait_for_files(tmp_path / "pairs", job)
    workers = cluster.worker_ids()
    assert len(workers) >= 2
    os.kill(workers[0], signal.SIGKILL)
    assert len(read_folder_files(tmp_path / "pairs")) < len(read_folder_files(alone))
    assert job.wait(400) == 0, job.stderr.read() if job.stderr else ""
    assert read_folder_files(tmp_path / "pairs") == read_folder_files(alone)


def test_a_killed_command_continues_with_the_same_bytes(cluster: LocalCluster, alone: Path, tmp_path: Path) -> None:
    job = start(tmp_path / "pairs", cluster)
    wait_for_files(tmp_path / "pairs", job)
    job.send_signal(signal.SIGKILL)
    job.wait()
    before = {path.name: path.stat().st_mtime_ns for path in (tmp_path / "pairs" / "data").glob("train-*")}
    assert 1 <= len(before) < 10
    again = start(tmp_path / "pairs", cluster)
    assert again.wait(400) == 0, again.stderr.read() if again.stderr else ""
    assert read_folder_files(tmp_path / "pairs") == read_folder_files(alone)
    assert all((tmp_path / "pairs" / "data" / name).stat().st_mtime_ns == at for name, at in before.items())


def test_build_gives_the_same_bytes(cluster: LocalCluster, alone: Path, tmp_path: Path) -> None:
    for name, options in (("one", ["--workers", "1"]), ("many", ["--cluster", cluster.address])):
        assert main(["dataset", "build", str(alone), "--out", str(tmp_path / name), "--json", *options]) == 0
    assert read_folder_files(tmp_path / "one") == read_folder_files(tmp_path / "many")


@pytest.fixture(scope="module")
def sensors_and_presses(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Some presses on two simulated sensors, whose calibrations are part of an evaluation."""
    out = tmp_path_factory.mktemp("presses") / "pairs"
    settings = ["--pairs", "16", "--sensors", "2", "--object-names", "ball:3", "cone", "--pitch-mm", "0.4"]
    assert main(["simulate", "dataset", "--out", str(out), "--json", "--workers", "1", *settings]) == 0
    return out


def evaluate(data: Path, out: Path, *options: str) -> bytes:
    """The predictions for a copy of a data set, whose sensors are calibrated first."""
    shutil.copytree(data, out / "pairs")
    assert main(["evaluate", "--data", str(out / "pairs"), "--out", str(out / "report"), "--json", *options]) == 0
    assert sorted(path.name for path in (out / "pairs" / "sensors").iterdir()) == ["twin_0_000", "twin_0_001"]
    return (out / "report" / "predictions.csv").read_bytes()


@pytest.fixture(scope="module")
def predictions_of_one_process(sensors_and_presses: Path, tmp_path_factory: pytest.TempPathFactory) -> bytes:
    return evaluate(sensors_and_presses, tmp_path_factory.mktemp("one"), "--workers", "1")


def test_evaluate_gives_the_same_bytes(
    cluster: LocalCluster, sensors_and_presses: Path, predictions_of_one_process: bytes, tmp_path: Path
) -> None:
    assert evaluate(sensors_and_presses, tmp_path, "--cluster", cluster.address) == predictions_of_one_process


def test_explore_gives_the_same_table(cluster: LocalCluster, tmp_path: Path) -> None:
    for name, options in (("one", ["--workers", "1"]), ("many", ["--cluster", cluster.address])):
        command = ["hardware", "explore", "--gel-mm", "2", "2.5", "--json", "--out", str(tmp_path / name), *options]
        assert main(command) == 0
    assert (tmp_path / "one" / "explore.json").read_bytes() == (tmp_path / "many" / "explore.json").read_bytes()


def test_errors_of_jobs_keep_their_class_and_sentence(cluster: LocalCluster) -> None:
    with connect_workers(1, cluster.address) as workers:
        with pytest.raises(InputError, match=r"^expected at least 1 worker, got 0; give one for each core$"):
            list(run_jobs(require_workers, [(0,)], workers))
        with pytest.raises(ZeroDivisionError):
            list(run_jobs(divmod, [(1, 0)], workers))
        assert dict(run_jobs(int, [(1,), (2,)], workers)) == {0: 1, 1: 2}


def test_a_job_that_kills_every_worker_is_one_sentence(cluster: LocalCluster) -> None:
    with connect_workers(1, cluster.address) as workers, pytest.raises(DeviceError, match="run the command again"):
        list(run_jobs(os._exit, [(1,)], workers))


def test_two_processes_train_one_model(alone: Path, tmp_path: Path) -> None:
    shutil.copytree(alone, tmp_path / "pairs")
    options = [
        "--channels",
        "deformation",
        "--size",
        "32",
        "24",
        "--epochs",
        "2",
        "--batch",
        "16",
        "--held-out",
        "object",
    ]
    machine = ["--accelerator", "cpu", "--devices", "2", "--strategy", "ddp", "--json"]
    folders = ["--data", str(tmp_path / "pairs"), "--out", str(tmp_path / "out")]
    command = [sys.executable, "-m", "ninedtact", "train", *folders, *options, *machine]
    done = subprocess.run(command, capture_output=True, text=True, timeout=400)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)  # the second process prints nothing
    assert (found["model"], found["epochs"]) == (str(tmp_path / "out" / "model.onnx"), 2)
    assert read_force_model(tmp_path / "out" / "model.onnx").card.training.epochs == 2


def test_sessions_in_threads_of_one_worker_give_the_same_bytes(alone: Path, tmp_path: Path) -> None:
    with dask_cluster(tmp_path, threads=2) as threaded:
        assert start(tmp_path / "pairs", threaded).wait(400) == 0
    assert read_folder_files(tmp_path / "pairs") == read_folder_files(alone)


def test_a_worker_of_another_version_is_refused(tmp_path: Path) -> None:
    package = tmp_path / "other" / "ninedtact"
    package.mkdir(parents=True)
    (package / "__init__.py").touch()
    metadata = package.parent / "ninedtact-0.0.9.dist-info" / "METADATA"
    metadata.parent.mkdir()
    metadata.write_text("Metadata-Version: 2.1\nName: ninedtact\nVersion: 0.0.9\n")
    with (
        dask_cluster(tmp_path, env={"PYTHONPATH": str(package.parent)}) as outdated,
        pytest.raises(DeviceError, match=rf"expected ninedtact {__version__} on .*got 0\.0\.9 on"),
        connect_workers(1, outdated.address),
    ):
        pass


@pytest.mark.parametrize("listens", [True, False])
def test_a_port_that_does_not_answer_is_refused_soon(listens: bool) -> None:
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        if listens:
            silent.listen()
        address, began = f"127.0.0.1:{silent.getsockname()[1]}", monotonic()
        with pytest.raises(DeviceError, match=f"that answers, got {address}"), connect_workers(1, address):
            pass
        assert monotonic() - began < CONNECT_TIMEOUT_S + 3


def test_an_address_that_is_none_is_refused() -> None:
    with pytest.raises(DeviceError, match=r"expected --cluster HOST:PORT .*, got slurm:somewhere"):
        connect_workers(1, "slurm:somewhere").__enter__()
