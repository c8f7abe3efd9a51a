"""Which images of one batch are another's: those under the same light, in the same material, from the same view.

A batch may grow: with more environments, rotations, materials or views, what is finished stays and the rest is made.
It may shrink by what is not finished, a map that cannot be read for one. All else has to be the same.
"""

from __future__ import annotations

from typing import Any

from prtcl.scene.frames import jobs

LISTS = ("environments", "rotations", "materials", "cameras")
"""Inputs of which an image has one each."""


def common(inputs: dict[str, Any]) -> dict[str, Any]:
    """What all images of a batch depend on.

    V ⊕ f_v traces rays for the sharpest of all materials, so that each of them counts for all images.
    """
    own = [key for key in LISTS if key != "materials" or inputs.get("factorization") != "view"]
    return {key: value for key, value in inputs.items() if key not in own}


def images(manifest: dict[str, Any]) -> dict[str, Any]:
    """What each image of a batch is of, by the name of its file.

    Raises
    ------
    KeyError, TypeError, ValueError
        If the manifest is none of ours.
    """
    inputs = manifest["inputs"]
    environments, rotations, materials, cameras = (list(inputs[key]) for key in LISTS)
    every = jobs(len(cameras), len(environments), len(rotations), len(materials))
    return {
        entry["file"]: [
            entry.get("png"), environments[own.light], rotations[own.rotation], materials[own.material],
            cameras[own.view],
        ]
        for entry, own in zip(manifest["frames"], every, strict=True)
    }  # fmt: skip
