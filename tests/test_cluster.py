"""`--scheduler`: a scheduler and two workers on loopback make what one process makes, byte for byte, whoever dies."""

from __future__ import annotations

import hashlib
import json
import os
import pickle
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from cases import DEMO_CAMERA, Ran, Run

from prtcl.apps import bake as bake_command
from prtcl.apps import cluster as shared
from prtcl.apps.parsers import parser
from prtcl.apps.relight import batch
from prtcl.apps.relight import cluster as relit
from prtcl.apps.relight import command as command_module
from prtcl.apps.relight import folder as folder_module
from prtcl.apps.relight.folder import opened
from prtcl.apps.relight.lock import unchanged
from prtcl.apps.relight.shared import Shared
from prtcl.compute import choice, tuning
from prtcl.compute.device import Device
from prtcl.errors import InputError, PrtclError
from prtcl.factors.environment import Environment
from prtcl.factors.material import anchored
from prtcl.files.image import write_exr
from prtcl.scene.factorization import engine_for
from prtcl.scene.mesh import Mesh
from prtcl.scene.shaders import Counter

distributed = pytest.importorskip("distributed", reason="the extra `cluster` is not installed")
ROOT = Path(__file__).resolve().parents[1]


class Cluster:
    """A scheduler and workers, each a process. They have no nannies: a worker that was killed stays away."""

    def __init__(self, place: Path) -> None:
        self.place, self.processes = place, []
        self.workers: list[subprocess.Popen[bytes]] = []
        self._start("scheduler", "--host", "127.0.0.1", "--port", "0")
        end = time.monotonic() + 30
        while not (place / "scheduler.json").exists() and time.monotonic() < end:
            time.sleep(0.05)
        self.address: str = json.loads((place / "scheduler.json").read_text())["address"]

    def _start(self, program: str, *more: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", f"distributed.cli.dask_{program}", "--scheduler-file",
                   str(self.place / "scheduler.json"), "--no-dashboard", *more]  # fmt: skip
        with (self.place / f"{program}.log").open("ab") as log:
            environment = {**os.environ, "PYTHONPATH": str(ROOT)}
            self.processes.append(
                subprocess.Popen(command, cwd=self.place, env=environment, stdout=log, stderr=log)
            )
        return self.processes[-1]

    def add(self) -> None:
        """One more worker, in another folder than that of the tests."""
        own = ("--no-nanny", "--nthreads", "1", "--memory-limit", "0", "--local-directory", str(self.place))
        self.workers.append(self._start("worker", *own))

    def kill(self) -> None:
        """Kill a worker, at whatever it is."""
        self.workers.pop(0).kill()

    def everywhere(self, function: Any) -> list[Any]:
        """What a function gives on every worker, once there are as many as should be."""
        with distributed.Client(self.address, set_as_default=False) as client:
            client.wait_for_workers(len(self.workers), timeout=30)
            return list(client.run(function).values())

    def end(self) -> None:
        """Kill all that is left."""
        for process in self.processes:
            process.kill()
            process.wait(timeout=30)


@contextmanager
def started(place: Path, workers: int) -> Iterator[Cluster]:
    cluster = Cluster(place)
    try:
        for _ in range(workers):
            cluster.add()
        yield cluster
    finally:
        cluster.end()


@pytest.fixture(scope="module")
def common(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    with started(tmp_path_factory.mktemp("cluster"), 2) as cluster:
        yield cluster


@pytest.fixture
def cluster(common: Cluster) -> Cluster:
    """With two workers, whatever the test before has killed."""
    while len(common.workers) < 2:
        common.add()
    common.everywhere(os.getpid)
    return common


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ball, a sky with a lamp, and a table."""
    folder = tmp_path_factory.mktemp("files")
    trimesh.creation.icosphere(subdivisions=2).export(folder / "ball.ply")
    image = np.ones((8, 16, 4), dtype=np.float32)
    image[2, 3, :3] = 40.0
    write_exr(folder / "sky.exr", image)
    angles = np.linspace(0.0, np.pi / 2, 4)
    np.savez(
        folder / "sheen.npz", values=np.arange(48.0).reshape(4, 4, 3) / 100, theta_h=angles, theta_d=angles
    )
    return folder


@pytest.fixture
def words(files: Path, opencl_device: choice.Seen, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """A job of 96 images, all but the output, in paths that hold in this process's folder alone."""
    monkeypatch.chdir(files)
    return ["relight", "ball.ply", "--env", "sky.exr", "--env-rotate", "0:360:15", "--brdf", "table:sheen.npz",
            "ggx:alpha=0.3,f0=0.04", "--turntable", "2", "--size", "12x8", "--samples", "1", "--levels", "3",
            "--views", "8", "--factorization", "light", "--quiet", "--device", opencl_device.spec]  # fmt: skip


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, str]]:
    """What one process made of a command, by the command."""
    return {}


@pytest.fixture
def whole(words: list[str], run: Run, tmp_path: Path, alone: dict[str, dict[str, str]]) -> dict[str, str]:
    """The folder that one process leaves."""
    key = " ".join(words)
    if key not in alone:
        assert run(*words, "-o", tmp_path / "alone").status == 0
        alone[key] = contents(tmp_path / "alone")
    assert len(alone[key]) == 96 + 3
    return alone[key]


def contents(folder: Path) -> dict[str, str]:
    """SHA-256 of every file of a folder and its folders."""
    found = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest() for p in found}


# --- the same bytes ----------------------------------------------------------------------------------------------


def test_two_workers_make_what_one_process_makes(
    run: Run, words: list[str], whole: dict[str, str], cluster: Cluster, tmp_path: Path
) -> None:
    ran = run(*words, "--json", "--scheduler", cluster.address, "-o", tmp_path / "out")
    assert ran.status == 0, ran.err
    assert contents(tmp_path / "out") == whole
    frames = [event["index"] for event in ran.events if event["event"] == "frame"]
    assert sorted(frames) == list(range(96))
    summary = ran.events[-1]
    assert summary["workers"] == 2 and summary["kernel_seconds"] > 0 and summary["ray_seconds"] > 0
    assert summary["writing_seconds"] > 0
    assert summary["utilisation"] == pytest.approx(summary["busy"] / summary["seconds"] / 2, abs=2e-3)


def test_workers_keep_visibility_in_the_folder_that_all_share(
    run: Run, words: list[str], cluster: Cluster, whole: dict[str, str], tmp_path: Path
) -> None:
    """Once kept, by one of them, no worker traces a view again; images are the same."""
    pytest.importorskip("zarr", reason="visibility is kept in Zarr stores")
    told = []
    for name in ("first", "again"):
        ran = run(
            *words,
            "--scheduler",
            cluster.address,
            "--keep-visibility",
            tmp_path / "kept",
            "-o",
            tmp_path / name,
        )
        assert ran.status == 0, ran.err
        assert contents(tmp_path / name) == whole
        told.append(ran.err)
    assert len(list((tmp_path / "kept").glob("*.zarr"))) == 2
    assert "keeps the view's visibility" in told[0] and "visibility was read" in told[1]


def test_a_transport_is_sent_to_the_other_worker(
    run: Run, words: list[str], cluster: Cluster, tmp_path: Path
) -> None:
    """One view: what the first worker traced, the other takes."""
    some = [w for w in words if w not in ("--turntable", "2", "--levels", "3", "--views", "8")]
    some[some.index("light")] = "view"
    some[some.index("0:360:15")] = "0:360:45"
    assert run(*some, "-o", tmp_path / "one").status == 0
    ran = run(*some, "--json", "--scheduler", cluster.address, "-o", tmp_path / "two")
    assert ran.status == 0, ran.err
    assert contents(tmp_path / "two") == contents(tmp_path / "one")


def test_a_killed_worker_costs_its_task(
    run: Run, words: list[str], whole: dict[str, str], cluster: Cluster, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    record, recorded = folder_module.Folder.record, []

    def recorded_so_far(folder: Any, number: int, digests: dict[str, str]) -> None:
        record(folder, number, digests)
        recorded.append(number)
        if len(recorded) == 10:
            cluster.kill()

    monkeypatch.setattr(folder_module.Folder, "record", recorded_so_far)
    ran = run(*words, "--chunk", "1", "--scheduler", cluster.address, "-o", tmp_path / "out")
    assert ran.status == 0 and ran.err == ""
    assert len(cluster.workers) == 1 and len(recorded) == 96
    assert contents(tmp_path / "out") == whole


@pytest.mark.parametrize("ending", ["npz", "zarr"])
def test_a_bake_is_the_same_though_a_worker_is_killed(
    run: Run, files: Path, cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: str
) -> None:
    if ending == "zarr":
        pytest.importorskip("zarr", reason="the extra `bake` is not installed")
    words = ["bake", files / "ball.ply", "--rays", "5", "--quiet"]
    assert run(*words, "-o", tmp_path / f"one.{ending}").status == 0

    class Deadly(Counter):
        def __call__(self, count: int) -> None:
            super().__call__(count)
            if self.done == 5:
                cluster.kill()

    monkeypatch.setattr(bake_command, "Counter", Deadly)
    ran = run(*words, "--chunk", "1", "--scheduler", cluster.address, "-o", tmp_path / f"two.{ending}")
    assert ran == (0, "", "")
    assert len(cluster.workers) == 1
    one, two = (
        contents(path) if path.is_dir() else path.read_bytes()
        for path in (tmp_path / f"one.{ending}", tmp_path / f"two.{ending}")
    )
    assert one == two


def test_a_bake_is_relit_by_workers(run: Run, words: list[str], cluster: Cluster, tmp_path: Path) -> None:
    assert run("bake", "ball.ply", "--rays", "3", "--quiet", "-o", tmp_path / "ball.npz").status == 0
    some = ["relight", tmp_path / "ball.npz", *words[2:]]
    some[some.index("0:360:15")] = "0:360:90"
    assert run(*some, "-o", tmp_path / "one").status == 0
    ran = run(*some, "--scheduler", cluster.address, "-o", tmp_path / "two")
    assert ran.status == 0, ran.err
    assert contents(tmp_path / "two") == contents(tmp_path / "one")


def test_a_worker_reads_the_same_job_wherever_it_was_started(
    words: list[str], files: Path, tmp_path: Path, opencl_device: choice.Seen, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Relative paths are the command's, and where the worker's environment names a device, it is that one."""
    options = parser().parse_args([*words, "-o", "out"])
    device = Device(opencl_device.spec)
    job = batch.read(options, device)
    told = relit.order(options, job)
    assert told.options["output"] == str(files / "out") and told.specs[0] == "table:sheen.npz"
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(choice.VARIABLE, opencl_device.spec)
    told.options["device"] = "none such"
    place = relit.Place(told)
    assert place.job.manifest["inputs"] == job.manifest["inputs"]
    assert place.device.name == opencl_device.name
    used = tuning.forms_of(device)
    tunable, form = next((t, f) for n, t in tuning.KNOWN.items() for f in t.forms if f != used[n])
    with (
        tunable.trial(form),
        pytest.raises(
            InputError, match=rf"kernels: {tunable.name} .* there.*\nhave one file of `prtcl bench"
        ),
    ):
        relit.Place(told)


def test_a_path_in_a_spec_starts_from_a_folder() -> None:
    assert anchored("merl:a b.binary,angles=2", "/x") == "merl:/x/a b.binary,angles=2"
    assert anchored("table:/y/a.npz", "/x") == "table:/y/a.npz"
    assert anchored("ggx:alpha=0.3,f0=0.04", "/x") == "ggx:alpha=0.3,f0=0.04"


@pytest.mark.parametrize("factorization", ["light", "view"])
def test_what_another_engine_traced_is_taken(
    device: Device, mesh: Mesh, sky: Environment, factorization: str
) -> None:
    """The same images, without a ray to the light but for those of hard light; and a view is prepared once."""
    camera = replace(DEMO_CAMERA, size=(12, 9))
    engines = [
        engine_for(mesh, ["lambert"], device, samples=2, factorization=factorization, hard="off")
        for _ in "ab"
    ]
    traced = engines[0].prepare(camera)
    before = engines[0].tracer.rays
    assert before > 0
    standing = relit.Standing(engines[1])
    taken = standing.prepare(camera, traced=pickle.loads(pickle.dumps(traced)))
    assert standing.prepare(camera) is taken and standing.device is device
    first, second = (next(engine.images([(sky, [0])])) for engine in (engines[0], standing))
    assert (first == second).all() and first[..., :3].max() > 0
    assert engines[0].tracer.rays == before and engines[1].tracer.rays == 0
    assert standing.prepare(replace(camera, fov=20.0)) is not taken and engines[1].tracer.rays > 0


def test_tasks_of_a_batch() -> None:
    """All materials under some neighbouring lights of one view; what is finished is left out."""
    job: Any = SimpleNamespace(
        views=[0, 1], lights=[0, 1], rotations=[0, 1, 2], materials=[0, 1], factorization="light"
    )
    every = list(range(24))
    assert list(relit.blocks(job, set(), 4)) == [
        (0, [every[0:8], every[8:12]]), (1, [every[12:20], every[20:24]])
    ]  # fmt: skip
    left = list(relit.blocks(job, {*range(12), 13, 20, 21, 22, 23}, 4))
    assert left == [(1, [[12, 14, 15, 16, 17, 18, 19]])]
    assert list(relit.blocks(job, set(every), 4)) == []
    # Six lights: eight at most, and a task for each of six workers, which share two views.
    assert [relit.lights_of_a_task(job, n) for n in (1, 2, 3, 5, 6, 99)] == [6, 6, 3, 2, 2, 1]
    many: Any = SimpleNamespace(views=[0], lights=[0] * 100, rotations=[0] * 3, factorization="light")
    assert relit.lights_of_a_task(many, 2) == 8
    many.factorization = "view"
    assert [relit.lights_of_a_task(many, n) for n in (1, 3, 4)] == [100, 100, 75]


# --- the end of a run --------------------------------------------------------------------------------------------


def test_an_interrupted_command_leaves_nothing_at_work(
    run: Run, words: list[str], whole: dict[str, str], cluster: Cluster, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip

    def at_work() -> tuple[object, object]:  # on a worker; sent as it is, since workers have no tests
        from prtcl.apps import cluster

        return cluster._run, cluster._kept

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(folder_module.Folder, "record", interrupt)
        ran = run(*words, "--scheduler", cluster.address, "-o", tmp_path / "out")
    assert ran.status == 130
    before = contents(tmp_path / "out")
    assert cluster.everywhere(at_work) == [(None, None)] * 2
    assert contents(tmp_path / "out") == before and len(before) < len(whole)
    ran = run(*words, "--scheduler", cluster.address, "-o", tmp_path / "out")
    assert ran.status == 0 and contents(tmp_path / "out") == whole


def test_a_worker_that_outlives_its_run_changes_nothing(tmp_path: Path) -> None:
    """Its command was killed, and another job with an image of the same name has the folder now."""
    jobs = [
        {"format": 1, "job": name * 64, "inputs": {"version": name}, "frames": [{"file": "a.exr"}]}
        for name in "ab"
    ]
    folder = tmp_path / "out"
    with opened(str(folder), jobs[0], False):
        orphan = Shared(folder, jobs[0])
        digest = orphan.write("a.exr", lambda path: path.write_bytes(b"old"))
        orphan.record(0, {"a.exr": digest})
        assert orphan.made == [(0, {"a.exr": hashlib.sha256(b"old").hexdigest()})]
    with opened(str(folder), jobs[1], True) as current:
        assert not (folder / "a.exr").exists()
        with pytest.raises(PrtclError, match=r"manifest\.json there is not this job's\nname a folder"):
            orphan.write("a.exr", lambda path: path.write_bytes(b"old"))
        assert not (folder / "a.exr").exists()
        current.record(0, {"a.exr": current.write("a.exr", lambda path: path.write_bytes(b"new"))})
        with pytest.raises(PrtclError, match="not this job's"):
            orphan.write("a.exr", lambda path: path.write_bytes(b"old"))
        (folder / f".{'0' * 32}.exr").write_bytes(b"half")  # as a worker that was killed leaves it
    assert (folder / "a.exr").read_bytes() == b"new"
    assert sorted(contents(folder)) == [".relight.lock", "a.exr", "finished.jsonl", "manifest.json"]


def test_a_worker_that_sees_another_folder_is_told(tmp_path: Path) -> None:
    with pytest.raises(PrtclError, match="name a folder with -o that all machines share"):
        Shared(tmp_path, {"job": "a", "frames": []}).write("a.exr", lambda path: path.write_bytes(b""))


def test_a_manifest_is_not_replaced_while_a_file_gets_its_name(tmp_path: Path) -> None:
    """A run that takes the folder over waits for workers that are at it, and these find the new manifest after."""
    manifest = tmp_path / "manifest.json"
    manifest.write_text("old")
    seen = []

    def worker() -> None:
        with unchanged(manifest, alone=False) as file:
            assert file is not None
            seen.append(os.pread(file, 10, 0))

    thread = threading.Thread(target=worker)
    with unchanged(manifest, alone=True):
        thread.start()
        thread.join(0.2)
        assert thread.is_alive() and not seen
        (tmp_path / "aside").write_text("new")
        os.replace(tmp_path / "aside", manifest)
    thread.join(30)
    assert seen == [b"new"]
    with unchanged(tmp_path / "none", alone=False) as nothing:
        assert nothing is None
    with pytest.raises(FileNotFoundError), unchanged(manifest, alone=False):
        raise FileNotFoundError("of what was written aside, which another run has removed")


# --- what is told ------------------------------------------------------------------------------------------------


def assert_told(ran: Ran, status: int, *words: str) -> None:
    """Two lines at most, that have these words."""
    assert ran.status == status and len(ran.err.splitlines()) <= 2, ran.err
    assert all(word in ran.err for word in words), ran.err


@pytest.mark.parametrize("command", ["relight", "bake"])
def test_no_scheduler(
    run: Run, words: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, command: str
) -> None:
    monkeypatch.setattr(shared, "REACHED", 0.5)
    given = words if command == "relight" else ["bake", "ball.ply", "--quiet"]
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))  # bound and not listening: refused
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
        ran = run(*given, "--scheduler", address, "-o", tmp_path / "out.npz")
    assert_told(ran, 1, address, "no scheduler answers", "dask scheduler")
    assert_told(run(*given, "--scheduler", "tcp://", "-o", tmp_path / "out.npz"), 1, "no scheduler answers")
    assert not (tmp_path / "out.npz").exists()


def test_no_workers_the_last_one_and_a_scheduler_that_goes_away(
    run: Run, words: list[str], whole: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    record, then = folder_module.Folder.record, []

    def recorded(folder: Any, *given: Any) -> None:
        record(folder, *given)
        while then:
            then.pop(0)()

    monkeypatch.setattr(folder_module.Folder, "record", recorded)
    with started(tmp_path, 0) as own:
        given = [*words, "--chunk", "1", "--scheduler", own.address, "-o", tmp_path / "out"]
        with monkeypatch.context() as hurried:
            hurried.setattr(shared, "REACHED", 2.0)
            ran = run(*given)
        assert_told(ran, 1, own.address, "has no workers", f"dask worker {own.address} --nthreads 1")

        own.add()
        own.everywhere(os.getpid)
        then[:] = [own.kill]
        with monkeypatch.context() as hurried:
            hurried.setattr(shared, "LOOK", 0.2)
            hurried.setattr(shared, "ABSENT", 1.0)
            ran = run(*given)
        assert_told(ran, 1, own.address, "has had no worker for 1 s", "the same command again")

        own.add()
        then[:] = [own.kill, own.add]  # what all workers were told dies with none of them
        assert run(*given).status == 0
        assert contents(tmp_path / "out") == whole

        own.everywhere(os.getpid)
        then[:] = [own.end]
        ran = run(*given[:-1], tmp_path / "more")
    assert_told(ran, 1, own.address, "the scheduler went away", "the same command again")


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (distributed.KilledWorker("task", None, 3), ["several workers died over one task", "--memory-limit"]),
        (ModuleNotFoundError("No module named 'prtcl'"), ["a worker cannot run this", "install prtcl"]),
        (ValueError(), ["a worker cannot run this: ValueError"]),
    ],
)
def test_what_dask_raises_is_told_in_two_lines(
    monkeypatch: pytest.MonkeyPatch, error: Exception, words: list[str]
) -> None:
    def fail(*_: object) -> Any:
        raise error

    workers = shared.Workers(SimpleNamespace(status="running"), "tcp://somewhere:1")
    monkeypatch.setattr(workers, "_answers", fail)
    with pytest.raises(PrtclError) as told:
        next(workers.answers([]))
    assert len(str(told.value).splitlines()) == 2
    assert all(word in str(told.value) for word in ["tcp://somewhere:1", *words])


def test_a_worker_of_another_version_is_told(
    run: Run, files: Path, cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shared, "versions", lambda: {"prtcl": "0.0.7", "embreex": "1"})
    ran = run("bake", files / "ball.ply", "--scheduler", cluster.address, "--quiet", "-o", tmp_path / "a.npz")
    assert_told(
        ran, 2, "worker tcp://127.0.0.1", "has prtcl ", "this command 0.0.7", "install the same prtcl"
    )
    assert not (tmp_path / "a.npz").exists()


def test_a_worker_with_another_device_is_told(
    run: Run, words: list[str], cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Device, "driver", "1.2.3")
    ran = run(*words, "--scheduler", cluster.address, "-o", tmp_path / "out")
    assert_told(
        ran, 2, "worker tcp://127.0.0.1", "what differs is device", "driver 1.2.3 here", "PRTCL_DEVICE"
    )
    assert not list((tmp_path / "out").glob("*.exr"))


def test_an_environment_that_a_worker_cannot_read_is_told(
    run: Run, words: list[str], files: Path, cluster: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The command can, as it checks before anything is made."""
    monkeypatch.setattr(command_module, "check_inputs", lambda *_: None)
    (tmp_path / "cut.exr").write_bytes((files / "sky.exr").read_bytes()[:300])
    words[words.index("sky.exr")] = str(tmp_path / "cut.exr")
    ran = run(*words, "--scheduler", cluster.address, "-o", tmp_path / "out")
    assert_told(ran, 2, "worker tcp://127.0.0.1", "cut.exr")


@pytest.mark.parametrize("text", ["0", "-1", "x", "1.5"])
def test_wrong_chunks(run: Run, words: list[str], text: str, tmp_path: Path) -> None:
    assert_told(run(*words, "--chunk", text, "-o", tmp_path / "out"), 2, "--chunk", "1 or more")
