"""Jobs in processes of this machine: they end with the parent. Clusters that cannot be used are refused in one sentence."""

import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from time import monotonic, sleep

import pytest
from threadpoolctl import threadpool_limits

from ninedtact.errors import DeviceError, InputError
from ninedtact.parallel_jobs import DaskCluster, require_workers, run_jobs, run_writing_jobs

GENERATE = [
    "simulate",
    "dataset",
    "--workers",
    "2",
    "--size",
    "64",
    "48",
    "--pairs",
    "4000",
    "--device",
    "cpu",
    "--json",
]


def child_processes(parent: int) -> set[int]:
    """The processes below one, its children's children included."""
    parents = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            parents[int(path.parent.name)] = int(path.read_text().rpartition(")")[2].split()[1])
        except OSError:
            continue
    found, new = set(), {parent}
    while new:
        new = {child for child, of in parents.items() if of in new} - found
        found |= new
    return found


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="expected /proc, which lists processes; run on Linux")
def test_a_killed_parent_leaves_no_workers(tmp_path: Path) -> None:
    out = tmp_path / "pairs"
    job = subprocess.Popen([sys.executable, "-m", "ninedtact", *GENERATE, "--out", str(out)])
    until = monotonic() + 120
    while len(child_processes(job.pid)) < 3 and job.poll() is None and monotonic() < until:
        sleep(0.1)
    sleep(1)  # both workers begin their first file, which takes them half a minute
    workers = child_processes(job.pid)
    assert len(workers) >= 3  # loky's tracker of resources is one of them
    job.send_signal(signal.SIGKILL)
    job.wait()
    killed = monotonic()
    while any(Path(f"/proc/{worker}").exists() for worker in workers) and monotonic() - killed < 10:
        sleep(0.1)
    assert not [worker for worker in workers if Path(f"/proc/{worker}").exists()]


def test_a_killed_worker_is_one_sentence() -> None:
    with pytest.raises(DeviceError, match="run the command again to continue"):
        list(run_jobs(_kill_itself, [(9,), (9,)], 2))


def _kill_itself(number: int) -> None:
    import os

    os.kill(os.getpid(), number)


def test_jobs_give_the_same_in_one_process_in_two_and_on_a_cluster(tmp_path: Path) -> None:
    """The cluster is one of threads, which leaves the number of BLAS threads as it is set for a worker."""
    jobs = [(number,) for number in range(5)]
    with ThreadPoolExecutor(2) as executor, threadpool_limits(1):
        for workers in (1, 2, DaskCluster("threads", 2, executor.submit)):
            assert dict(run_jobs(_square, jobs, workers)) == {number: number**2 for number in range(5)}
            folder = tmp_path / str(workers if isinstance(workers, int) else "cluster")
            folder.mkdir()
            written = sorted(run_writing_jobs(_write_square, folder, jobs, workers))
            assert written == [(number, number) for number in range(5)]
            found = {path.relative_to(folder).as_posix(): path.read_text() for path in folder.rglob("*.txt")}
            assert found == {f"{number}/square.txt": str(number**2) for number in range(5)}
            assert len(list(folder.iterdir())) == 5
            with pytest.raises(InputError, match="got 0; give one for each core"):
                list(run_jobs(require_workers, [(0,), (0,)], workers))


def _square(number: int) -> int:
    return number**2


def _write_square(folder: Path, number: int) -> int:
    (folder / str(number)).mkdir()
    (folder / str(number) / "square.txt").write_text(str(number**2))
    return number


def test_a_source_that_a_worker_does_not_find_is_named(tmp_path: Path) -> None:
    from ninedtact.errors import InputError
    from ninedtact_train.dataset.build import _make_part
    from ninedtact_train.dataset.checks import PairCheckSettings
    from ninedtact_train.dataset.sources.htt_episodes import TactileTransformerSource

    source = TactileTransformerSource("in", tmp_path / "in")
    with pytest.raises(InputError, match=f"expected {tmp_path}/in on .*, got nothing there"):
        _make_part(tmp_path, source, tmp_path / "in" / "1.npz", 0, PairCheckSettings())
