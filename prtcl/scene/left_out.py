"""What a finished render left out, and what that saved: counts from the run, seconds and bytes as estimates from it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from prtcl import quadtree
from prtcl.compute.chunks import chunk_size
from prtcl.factors.material import COLOURED_CONDUCTOR
from prtcl.transport.leave_out import Item
from prtcl.transport.pipeline import Pipeline

if TYPE_CHECKING:
    from prtcl.scene.scene import Scene

PRODUCT = (
    "environment_gather", "light_times_visibility", "haar_forward", "visibility_coefficients", "parent_sums",
    "triple_accumulate", "reduce_pair", "inner_product",
)  # fmt: skip
"""Device stages whose work goes with points and channels."""


def left_out(
    scene: Scene, pipelines: list[Pipeline], vertex: bool, shaded: int, seconds: dict[str, float]
) -> list[Item]:
    """An item for every name by which something was left out.

    Parameters
    ----------
    vertex : whether radiance was computed at the mesh's vertices
    shaded : points of soft light
    seconds : by stage
    """
    count = {
        name: sum(own.tally[name][0] for own in pipelines)
        for name in ("rays", "horizon", "unlit", "unshadowed", "normals", "views")
    }
    of = {name: sum(own.tally[name][1] for own in pipelines) for name in count}
    worked = max(1, shaded - count["unlit"] - count["normals"])
    each = sum(seconds.get(stage, 0.0) for stage in PRODUCT) / worked
    real = np.dtype(scene.device.dtype).itemsize
    first = pipelines[0]
    stages = first.bytes_per_point()
    flight = min(shaded, chunk_size(scene.device, sum(stages.values()), max(stages.values()), None))
    row = real * first.channels * quadtree.n_samples(first.settings.keep)

    def share(name: str, stage: str) -> float:
        """Seconds that what was left out would have taken, at the rate of what was not."""
        done = of[name] - count[name]
        return seconds.get(stage, 0.0) * count[name] / done if done > 0 else 0.0

    slices = first.materials.channels * quadtree.n_samples(first.settings.keep) * real
    items = [
        Item("rays", count["rays"], of["rays"], "rays", share("rays", "visibility_rays")),
        Item(
            "horizon",
            count["horizon"],
            of["horizon"],
            "rays to hard light",
            share("horizon", "hard_light_rays"),
        ),
        Item("unlit", count["unlit"], of["unlit"], "points", each * count["unlit"]),
        Item("unshadowed", count["unshadowed"], of["unshadowed"], "points' weights"),
        Item("normals", count["normals"], of["normals"], "points", each * count["normals"]),
        Item(
            "views",
            count["views"],
            of["views"],
            "slices",
            share("views", "brdf_slices"),
            slices * count["views"],
        ),
    ]
    if first.light.grey and first.channels == 1:
        items.append(Item("grey", 2, 3, "channels", 2 * each * worked, 2 * row * flight))
    dropped = max(own.settings.levels - own.settings.keep for own in pipelines)
    if dropped > 0 and scene.fitted:
        fine = real * first.channels * quadtree.n_samples(first.settings.levels) - row
        items.append(
            Item(
                "levels",
                dropped,
                first.settings.levels,
                "levels",
                0.0,
                fine * flight,
                max(scene.fitted.values()),
            )
        )
    if vertex:
        unseen = len(scene.mesh.vertices) - shaded
        words = 4 * quadtree.visibility_words(first.settings.rays)
        whole = sum(value for name, value in seconds.items() if name != "camera_rays") / max(1, shaded)
        items.append(
            Item("unseen", unseen, len(scene.mesh.vertices), "vertices", whole * unseen, words * unseen)
        )
    bits = COLOURED_CONDUCTOR + 1
    built = max(bin(own.materials.mask).count("1") for own in pipelines)
    items.append(Item("terms", bits - built, bits, "kinds of material"))
    return [item for item in items if item.count > 0]
