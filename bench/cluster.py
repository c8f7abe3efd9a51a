"""How the time of a batch and of a bake falls with workers of one core each, beside one process on one core and on two.

    python bench/cluster.py [-o bench/results/cluster.json] [--runs 5] [--mesh nefertiti] [--size 128x128]
        [--rotations 8] [--bake bob_342k] [--rays 5]

Linux only. Every process is held to its cores by its affinity, which NumPy, embree and OpenCL's runtimes for CPUs take
for the cores there are; `cores_busy`, CPU seconds over wall seconds, shows whether they did. Scheduler and command may
run on either core, so that on a machine of two cores two workers have less than two. Neither a network nor a file
system that machines share is measured.

A run is the whole command, from its start to its end: seconds are the wall's, imports included (about one and a half);
`told` is the command's own clock, which starts after them. The first run of each setting is left out: it compiles
kernels and fills the page cache. All settings must leave the same bytes, or the bench fails.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import scenes

from prtcl.apps.arguments import size
from prtcl.compute.device import Device

MATERIALS = ("lambert:albedo=0.5", "ggx:alpha=0.3,f0=0.04,kd=0.5", "ggx:alpha=0.4,f0=1.0/0.77/0.34")
ENVIRONMENTS = ("lebombo", "kloppenheim_05")
TICK = os.sysconf("SC_CLK_TCK")


def held(command: list[str], cores: set[int], **more: Any) -> subprocess.Popen[str]:
    """A process on some cores."""
    return subprocess.Popen(
        [sys.executable, "-m", *command], preexec_fn=lambda: os.sched_setaffinity(0, cores), text=True, **more
    )


def cpu_seconds(process: subprocess.Popen[str]) -> float:
    """What a running process has used so far, its threads too."""
    fields = Path(f"/proc/{process.pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / TICK


@contextmanager
def workers(
    cores: list[int], every: set[int], place: Path
) -> Iterator[tuple[str, list[subprocess.Popen[str]]]]:
    """A scheduler's address, and one worker on each of some cores."""
    file = place / "scheduler.json"
    common = ["--scheduler-file", str(file), "--no-dashboard"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL, "cwd": place}
    running = []
    try:
        local = ["--host", "127.0.0.1", "--port", "0"]
        running.append(held(["distributed.cli.dask_scheduler", *common, *local], every, **quiet))
        end = time.monotonic() + 60
        while not file.exists() and time.monotonic() < end:
            time.sleep(0.05)
        own = ["--no-nanny", "--nthreads", "1", "--memory-limit", "0", "--local-directory", str(place)]
        for core in cores:
            running.append(held(["distributed.cli.dask_worker", *common, *own], {core}, **quiet))
        address = json.loads(file.read_text())["address"]
        from distributed import Client

        with Client(address, set_as_default=False) as client:
            client.wait_for_workers(len(cores), timeout=60)
        yield address, running[1:]
    finally:
        for process in running:
            process.kill()
            process.wait()
        file.unlink(missing_ok=True)


def digest(path: Path) -> str:
    """Of a file, or of a folder's files and their names."""
    if path.is_file():
        return hashlib.sha256(path.read_bytes()).hexdigest()
    total = hashlib.sha256()
    for file in sorted(path.iterdir()):
        total.update(f"{file.name} {digest(file)}\n".encode())
    return total.hexdigest()


def timed(
    words: list[str], cores: set[int], output: Path, runs: int, crew: list[subprocess.Popen[str]]
) -> tuple[dict[str, Any], str]:  # fmt: skip
    """A setting's row, and the digest of what it left."""
    walls, told, busy, digests = [], [], [], set()
    for run in range(runs + 1):
        out = output.with_name(f"{run}-{output.name}")
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        crew_before = sum(map(cpu_seconds, crew))
        start = time.perf_counter()
        with held(["prtcl", *words, "-o", str(out)], cores, stdout=subprocess.PIPE) as process:
            text, _ = process.communicate()
        wall = time.perf_counter() - start
        if process.returncode:
            sys.exit(f"prtcl {' '.join(words)} failed")
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        own = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        summary = json.loads(text.splitlines()[-1]) if words[0] == "relight" else json.loads(text)
        digests.add(digest(out))
        if run:
            walls.append(wall)
            told.append(summary["seconds"] if words[0] == "relight" else summary["seconds"]["total"])
            busy.append((own + sum(map(cpu_seconds, crew)) - crew_before) / wall)
    if len(digests) > 1:
        sys.exit(f"two runs of prtcl {' '.join(words)} left different bytes")
    return {
        "seconds": [round(t, 2) for t in sorted(walls)], "median": round(statistics.median(walls), 2),
        "told": round(statistics.median(told), 2), "cores_busy": round(statistics.median(busy), 2),
    }, digests.pop()  # fmt: skip


def settings(words: list[str], name: str, runs: int, place: Path) -> list[dict[str, Any]]:
    """Rows of one process on one core and on two, and of one worker and two."""
    cores = sorted(os.sched_getaffinity(0))[:2]
    if len(cores) < 2:
        sys.exit("two cores are needed")
    rows, digests = [], set()
    for label, own in (("1 process, 1 core", cores[:1]), ("1 process, 2 cores", cores)):
        row, left = timed(words, set(own), place / f"{len(own)}{name}", runs, [])
        rows.append({"setting": label, **row})
        digests.add(left)
        print(rows[-1], flush=True)
    for count in (1, 2):
        with workers(cores[:count], set(cores), place) as (address, crew):
            row, left = timed(
                [*words, "--scheduler", address], set(cores), place / f"{count}w{name}", runs, crew
            )
        rows.append({"setting": f"{count} worker{'s' * (count > 1)} of 1 core", **row})
        digests.add(left)
        print(rows[-1], flush=True)
    if len(digests) > 1:
        sys.exit("workers and one process left different bytes")
    alone = rows[0]["median"]
    return [row | {"times_as_fast": round(alone / row["median"], 2)} for row in rows]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--mesh", default="nefertiti", help="of the batch")
    parser.add_argument("--size", type=size, default=(128, 128))
    parser.add_argument("--rotations", type=int, default=8, help="of each of two environments")
    parser.add_argument("--factorization", choices=("light", "view"), default="light")
    parser.add_argument("--bake", default="bob_342k", help="the mesh that is baked")
    parser.add_argument("--rays", type=int, default=5)
    options = parser.parse_args()
    scenes.require_data()
    size_text, step = f"{options.size[0]}x{options.size[1]}", 360.0 / options.rotations
    batch = [
        "relight", str(scenes.mesh_path(options.mesh)), "--env",
        *(str(scenes.environment_path(name)) for name in ENVIRONMENTS), "--env-rotate", f"0:360:{step:g}",
        "--brdf", *MATERIALS, "--turntable", "2", "--size", size_text, "--factorization", options.factorization,
        "--quiet", "--json",
    ]  # fmt: skip
    bake = ["bake", str(scenes.mesh_path(options.bake)), "--rays", str(options.rays), "--quiet", "--json"]
    with tempfile.TemporaryDirectory(prefix="prtcl-cluster-") as folder:
        images = settings(batch, "images", options.runs, Path(folder))
        baked = settings(bake, ".npz", options.runs, Path(folder))
    device = Device()
    scenes.save(
        options.output,
        command=" ".join(["python bench/cluster.py", *sys.argv[1:]]),
        device=device.name, driver=device.driver, cores=os.cpu_count(), runs=options.runs,
        batch={
            "mesh": options.mesh, "size": list(options.size), "environments": ENVIRONMENTS, "views": 2,
            "rotations": options.rotations, "materials": MATERIALS, "factorization": options.factorization,
            "images": 2 * options.rotations * len(MATERIALS) * 2, "settings": images,
        },
        bake={"mesh": options.bake, "rays": options.rays, "settings": baked},
    )  # fmt: skip


if __name__ == "__main__":
    main()
