"""`prtcl relight`: images of a mesh under every environment, in every material, from every view."""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from prtcl.apps.cluster import Workers, connected
from prtcl.apps.progress import bar
from prtcl.apps.relight import batch, cluster
from prtcl.apps.relight.checks import check_inputs
from prtcl.apps.relight.folder import Folder, opened
from prtcl.apps.relight.images import SECONDS, make_images
from prtcl.apps.relight.manifest import MANIFEST
from prtcl.compute.device import Device
from prtcl.factors.visibility import Tracer
from prtcl.scene.bake import read_mesh_or_bake
from prtcl.scene.frames import Sources, jobs
from prtcl.scene.frames_points import check_view

Tell = Callable[..., None]


def run(options: argparse.Namespace) -> int:
    """Make what is missing of the batch, and report."""
    start = time.perf_counter()
    with connected(options.scheduler) as workers:
        device = Device(options.device, precision=options.precision)
        job = batch.read(options, device, _note)
        for note in job.notes:
            _note(note)
        if options.explain:
            _note(f"factorization {job.factorization}: {job.choice.reason}")
        tell: Tell = _event if options.json else _silent
        with opened(options.output, job.manifest, options.overwrite) as folder:
            report = make(job, folder, device, options, tell, workers)
    seconds = time.perf_counter() - start
    report |= {
        "seconds": round(seconds, 3),
        "frames_per_second": round(report["frames"] / seconds, 3),
        "utilisation": round(report["busy"] / (seconds * report["workers"]), 3),
    }
    tell("summary", **report)
    if not options.json and not options.quiet:
        print(summary(options.output, report))
    return 0


def make(
    job: batch.Batch, folder: Folder, device: Device, options: argparse.Namespace, tell: Tell,
    workers: Workers | None,
) -> dict[str, Any]:  # fmt: skip
    """Compute and write the images that are missing; returns what is told of them.

    `busy` is the sum of the kernels' seconds, by OpenCL's own clock, and the wall seconds in which rays were traced.
    Where a GPU computes while the host traces, both count. With workers these are sums over them, and utilisation is
    that of all their devices together.
    """
    entries = job.manifest["frames"]
    finished = folder.finished
    waiting = len(entries) - len(finished)
    tell(
        "started", output=options.output, frames=len(entries), skipped=len(finished), device=device.name,
        manifest=f"{options.output}/{MANIFEST}",
    )  # fmt: skip
    for number in sorted(finished):
        tell("skipped", index=number, **entries[number])
    spent, count = dict.fromkeys(SECONDS, 0.0), 1
    if waiting:
        engine = None if workers is not None else job.engine(device, not options.one_sided)
        sources = Sources(job.lights, options.env_up, options.repair, _note)
        every = jobs(len(job.views), len(job.lights), len(job.rotations), len(job.materials))
        missing = [own for own in every if own.index not in finished]
        mesh, _ = read_mesh_or_bake(job.source)
        tracer = Tracer(mesh.vertices, mesh.faces) if engine is None else engine.tracer
        # Of their machines' memory only the workers know.
        check = partial(check_view, tracer, mesh, 0.0 if engine is None else engine.pixel_bytes)
        with bar("read", options.quiet, " maps", scale=False) as notify:
            check_inputs(missing, job.views, sources, check, notify)
        device.profile.reset()
        with bar("relight", options.quiet, " images", scale=False) as notify:
            done = 0

            def told(number: int, entry: dict[str, Any]) -> None:
                nonlocal done
                done += 1
                tell("frame", index=number, done=len(finished) + done, **entry)
                if notify is not None:
                    notify(done, waiting)

            if notify is not None:
                notify(0, waiting)
            if workers is None:
                assert engine is not None
                spent = make_images(
                    job, folder, device, options, wanted=lambda own: own.index not in finished, told=told,
                    engine=engine, sources=sources,
                )  # fmt: skip
            else:
                spent, count = cluster.spread(workers, options, job, folder, told, _note)
    return {
        "output": options.output,
        "frames": waiting,
        "skipped": len(finished),
        "device": device.name,
        "workers": count,
        "busy": round(spent["kernel_seconds"] + spent["ray_seconds"], 3),
        **{name: round(seconds, 3) for name, seconds in spent.items()},
    }


def summary(output: str, report: dict[str, Any]) -> str:
    """One line on what was made."""
    if not report["frames"]:
        return f"{output}: all {report['skipped']} images were there"
    more = f" × {report['workers']}" if report["workers"] > 1 else ""
    there = f", {report['skipped']} were there" if report["skipped"] else ""
    return (
        f"{output}: {report['frames']} images{there}, {report['seconds']:.1f} s, "
        f"{report['frames_per_second']:.2f} images/s, kernels or rays ran {100 * report['utilisation']:.0f} % of the "
        f"time, on {report['device']}{more}"
    )


def _event(kind: str, **fields: Any) -> None:
    print(json.dumps({"event": kind, **fields}), flush=True)


def _silent(kind: str, **fields: Any) -> None:
    """Nobody listens."""


def _note(text: str) -> None:
    print(f"prtcl relight: {text}", file=sys.stderr)
