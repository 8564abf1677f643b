"""A Dask cluster on this machine: a scheduler and workers in processes of their own, on ports that are free."""

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

PATIENCE = 120.0  # s for the scheduler to write its file


@dataclass(frozen=True)
class LocalCluster:
    address: str
    scheduler: subprocess.Popen[bytes]
    workers: list[subprocess.Popen[bytes]]


def start_worker(address: str, folder: Path) -> subprocess.Popen[bytes]:
    """Start a worker of one thread, whose log and files go to a folder."""
    options = ["--nworkers", "1", "--nthreads", "1", "--no-nanny", "--no-dashboard", "--host", "127.0.0.1"]
    with folder.joinpath("workers.log").open("ab") as log:
        return subprocess.Popen(
            [sys.executable, "-m", "dask", "worker", address, *options, "--local-directory", str(folder)],
            cwd=folder,  # nothing of the caller's folder is found by chance
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
        )


@contextmanager
def local_cluster(workers: int, folder: Path) -> Iterator[LocalCluster]:
    """Start a scheduler and workers; end them afterwards, whatever has become of them."""
    file = folder / "scheduler.json"
    options = ["--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--scheduler-file", str(file)]
    with folder.joinpath("scheduler.log").open("wb") as log:
        scheduler = subprocess.Popen(
            [sys.executable, "-m", "dask", "scheduler", *options],
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
        )
    processes: list[subprocess.Popen[bytes]] = []
    try:
        deadline = time.monotonic() + PATIENCE
        while not (file.exists() and file.read_text()):
            if scheduler.poll() is not None or time.monotonic() > deadline:
                raise RuntimeError(f"no Dask scheduler: {folder.joinpath('scheduler.log').read_text()[-500:]}")
            time.sleep(0.05)
        address = str(json.loads(file.read_text())["address"])
        processes.extend(start_worker(address, folder) for _ in range(workers))
        yield LocalCluster(address, scheduler, processes)
    finally:
        for process in (*processes, scheduler):
            process.kill()
        for process in (*processes, scheduler):
            process.wait()
