"""What is told of a render: settings, time by stage, points a second, bytes a point."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from prtcl.scene.left_out import left_out
from prtcl.scene.shaders import Counter, Layer
from prtcl.transport.pipeline import Pipelines
from prtcl.transport.several import Several

if TYPE_CHECKING:
    from prtcl.scene.scene import Scene

PER_POINT = (
    "visibility_rays", "hard_light_rays", "environment_gather", "light_times_visibility", "haar_forward",
    "visibility_coefficients", "parent_sums", "triple_accumulate", "reduce_pair", "inner_product", "shade_lights",
)  # fmt: skip
"""Stages whose work is proportional to the points."""
HARD = ("hard_light_rays", "shade_lights")
"""Of these, those whose points are the hard light's."""


def covered(layers: list[Layer]) -> npt.NDArray[np.bool_]:
    """(pixels,) where some layer saw the mesh."""
    return np.any([layer.film.coverage() > 0 for layer in layers], axis=0)


def render_report(
    scene: Scene, pipeline: Pipelines | Several, layers: list[Layer], count: Counter, vertex: bool, rays: int,
    seconds: float,
) -> dict[str, Any]:  # fmt: skip
    """The report of a finished render.

    Parameters
    ----------
    vertex : whether radiance was computed at the mesh's vertices
    rays : that were traced; seconds : of the wall, in all
    """
    device = scene.device
    stages = _seconds(scene)
    seen = covered(layers)
    mean = np.sum([layer.film.mean().mean(axis=1) for layer in layers], axis=0)
    variance = np.sum([layer.film.variance() for layer in layers], axis=0)
    error = np.sqrt(variance[seen].mean()) / mean[seen].mean() if mean.sum() > 0 else 0.0
    shaded = count.by_stage
    # Which layer's points a stage works on: each point goes through one pipeline, so all pipelines' are its sum.
    main = shaded.get("vertex", shaded.get("soft", 0))
    return {
        "device": " + ".join(own.name for own in scene.devices),
        "device_reason": device.reason,
        "precision": device.precision,
        "mesh": {
            "name": scene.mesh.name,
            "vertices": len(scene.mesh.vertices),
            "faces": len(scene.mesh.faces),
        },
        "materials": [m.spec for m in scene.materials],
        "settings": [{**own.plain(), "why": reason} for own, reason in dict(scene.settings).items()],
        "light": {
            "hard_samples": len(pipeline.light.hard),
            "hard_share": round(pipeline.light.hard_share, 4),
            "channels": max(own.channels for own in pipeline.all),
        },
        "left_out": [vars(item) for item in left_out(scene, pipeline.all, vertex, main, stages)],
        "points": "vertex" if vertex else "pixel",
        "points_shaded": shaded,
        "rays": rays,
        "points_per_pixel": [float(l.film.points[seen].mean()) if seen.any() else 0.0 for l in layers],
        "pixel_error_estimate": float(error),
        "seconds": {"total": seconds, **{k: round(v, 4) for k, v in stages.items()}},
        "points_per_second": {
            k: round((shaded.get("hard", main) if k in HARD else main) / v)
            for k, v in stages.items()
            if v > 0 and k in PER_POINT
        },
        "bytes_per_point": device.profile.bytes_per_point(),
        "notes": scene.notes,
    }


def _seconds(scene: Scene) -> dict[str, float]:
    """Seconds by stage, of several devices together: kernels', then the host's."""
    out: defaultdict[str, float] = defaultdict(float)
    for own in scene.devices:
        for stage, seconds in own.profile.device_seconds().items():
            out[stage] += seconds
    for own in scene.devices:
        for stage, seconds in own.profile.host_seconds().items():
            out[stage] += seconds
    return dict(out)
