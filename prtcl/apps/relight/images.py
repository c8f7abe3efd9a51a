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
    told: Callable[[int, dict[str, Any]], object], engine: Engine, sources: Sources,
) -> dict[str, float]:  # fmt: skip
    """Compute and write the images that are wanted.

    Parameters
    ----------
    told : called with each image's number and entry of the manifest, once it is on the disk
    engine, sources : of this batch

    Returns
    -------
    seconds : `SECONDS`, of the device since its profile was last reset
    """
    frames = relight(
        job.source, sources, job.materials, job.views, rotations=job.rotations, wanted=wanted, engine=engine
    )
    with closing(frames), Writer(folder, options.exposure, told) as writer:
        for frame in frames:
            writer.put(frame)
    host, kernels = device.profile.host_seconds(), sum(device.profile.device_seconds().values())
    rays = sum(host.get(stage, 0.0) for stage in BUSY)
    spent = (kernels, rays, host.get("wait_for_light", 0.0), writer.waited, writer.busy)
    return dict(zip(SECONDS, spent, strict=True))
