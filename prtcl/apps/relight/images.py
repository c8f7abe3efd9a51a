"""Images of a batch computed and written one after another, and what the seconds went into."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from contextlib import closing
from typing import Any

from prtcl.apps.relight.batch import Batch
from prtcl.apps.relight.folder import Folder
from prtcl.apps.relight.writer import Writer
from prtcl.compute.device import Device
from prtcl.scene.frames import Job, Sources, relight
from prtcl.scene.frames_engine import BUSY, Engine

SECONDS = (
    "kernel_seconds", "ray_seconds", "waited_for_light_seconds", "waited_for_writing_seconds", "writing_seconds",
)  # fmt: skip
"""Of kernels, by OpenCL's own clock; of rays, by the wall; of waiting for files; of the thread that writes."""


def make_images(
    job: Batch, folder: Folder, device: Device, options: argparse.Namespace, *, wanted: Callable[[Job], bool],
    told: Callable[[int, dict[str, Any]], object], note: Callable[[str], object] | None = None,
    engine: Engine | None = None, sources: Sources | None = None,
) -> dict[str, float]:  # fmt: skip
    """Compute and write the images that are wanted.

    Parameters
    ----------
    told : called with each image's number and entry of the manifest, once it is on the disk
    note : called with notes on lights
    engine, sources : of this batch, where they are kept for more of its images; `note` is then that of `sources`

    Returns
    -------
    seconds : `SECONDS`, of the device since its profile was last reset
    """
    frames = relight(
        job.source, sources or job.lights, job.materials, job.views, rotations=job.rotations, points=job.points,
        samples=job.samples, factorization=job.factorization, up=options.env_up, repair=options.repair,
        device=device, two_sided=not options.one_sided, wanted=wanted, note=note, engine=engine or job.choice.engine,
        kept=job.kept, **job.settings,
    )  # fmt: skip
    with closing(frames), Writer(folder, options.exposure, told) as writer:
        for frame in frames:
            writer.put(frame)
    host, kernels = device.profile.host_seconds(), sum(device.profile.device_seconds().values())
    rays = sum(host.get(stage, 0.0) for stage in BUSY)
    spent = (kernels, rays, host.get("wait_for_light", 0.0), writer.waited, writer.busy)
    return dict(zip(SECONDS, spent, strict=True))
