"""What a batch is made of, what its folder is to hold; in what two batches differ, and which images they share.

Images are one another's under the same light, in the same material, from the same view, where all else is the same. So
a batch may grow: with more environments, rotations, materials or views, what is finished stays and the rest is made. It
may shrink by what is not finished, a map that cannot be read for one.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from prtcl.apps.relight import names
from prtcl.apps.relight.inputs import as_json
from prtcl.files.digest import json_sha256
from prtcl.scene.frames import Job, jobs

MANIFEST = "manifest.json"
FORMAT = 1
LISTS = ("environments", "rotations", "materials", "cameras")
"""Inputs of which an image has one each."""


def manifest_of(made_of: dict[str, Any], lights: Sequence[Path], expected: dict[str, Any]) -> dict[str, Any]:
    """The manifest of a batch, as it is once it has been written and read again.

    Parameters
    ----------
    made_of : all that the images depend on: environments and cameras with their names, materials as (SPEC, digest)
    lights : the environments' files
    expected : what a plan promises, if anything
    """
    environments, rotations, materials, cameras = (made_of[key] for key in LISTS)
    specs = [spec for spec, _ in materials]
    material_names = names.unique(map(names.material_name, specs))
    turns = names.rotation_names(rotations)
    every = list(_every(made_of))
    stems = names.unique(
        names.file_stem(
            environments[j.light][0], turns[j.rotation], material_names[j.material], cameras[j.view][0]
        )
        for j in every
    )
    manifest = as_json({
        "format": FORMAT,
        "job": json_sha256(made_of),
        "about": "images are linear RGBA, float32, colour premultiplied by alpha; rotation in degrees about the up "
        "axis, counter-clockwise from above; fov horizontal, in degrees; finished.jsonl lists what is done",
        "inputs": made_of,
        **expected,
        "environments": [
            {"name": name, "file": str(path), "sha256": digest}
            for (name, digest), path in zip(environments, lights, strict=True)
        ],
        "materials": [
            {"name": name, "spec": spec} for name, spec in zip(material_names, specs, strict=True)
        ],
        "views": [{"name": name, **camera} for name, camera in cameras],
        "frames": [
            {
                **files, "environment": environments[j.light][0], "rotation": rotations[j.rotation],
                "material": material_names[j.material], "view": cameras[j.view][0],
            }
            for files, j in zip(frame_files(stems, made_of["png"]), every, strict=True)
        ],
    })  # fmt: skip
    return dict(manifest)


def frame_files(stems: Sequence[str], png: bool) -> list[dict[str, str]]:
    """The files of every image."""
    return [{"file": f"{stem}.exr", **({"png": f"{stem}.png"} if png else {})} for stem in stems]


def common(made_of: dict[str, Any]) -> dict[str, Any]:
    """What all images of a batch depend on.

    V ⊕ f_v traces rays for the sharpest of all materials, so that each of them counts for all images.
    """
    own = [key for key in LISTS if key != "materials" or made_of.get("factorization") != "view"]
    return {key: value for key, value in made_of.items() if key not in own}


def images(manifest: dict[str, Any]) -> dict[str, Any]:
    """What each image of a batch is of, by the name of its file.

    Raises
    ------
    KeyError, TypeError, ValueError
        If the manifest is none of ours.
    """
    made_of = manifest["inputs"]
    environments, rotations, materials, cameras = (made_of[key] for key in LISTS)
    if not all(
        is_image(entry[key]) for entry in manifest["frames"] for key in ("file", "png") if key in entry
    ):
        raise ValueError
    return {
        entry["file"]: [
            entry.get("png"), environments[own.light], rotations[own.rotation], materials[own.material],
            cameras[own.view],
        ]
        for entry, own in zip(manifest["frames"], _every(made_of), strict=True)
    }  # fmt: skip


def is_image(name: Any) -> bool:
    """Whether a file of this name may be a batch's image, in its own folder."""
    if not isinstance(name, str) or not name.isascii() or not name.isprintable():
        return False
    return Path(name).name == name and Path(name).suffix in (".exr", ".png")


def difference(was: dict[str, Any], wanted: dict[str, Any]) -> str:
    """The first thing in which two manifests differ, in words."""
    before, now = was.get("inputs"), wanted["inputs"]
    if was.get("format") != wanted["format"] or not isinstance(before, dict):
        return f"{MANIFEST}, which is none of this version's"
    for key in sorted(now, key=lambda key: key in LISTS):  # these may differ, as long as finished images stay
        old, value = before.get(key), now[key]
        if isinstance(old, dict) and isinstance(value, dict):
            own = [name for name in value if old.get(name) != value[name]]
            if own:
                return f"{key}: {own[0]} {old.get(own[0])} there, {value[own[0]]} here"
        elif old != value:
            simple = all(own is None or isinstance(own, str | int | float | bool) for own in (old, value))
            short = simple and len(f"{old}{value}") < 200
            return f"{key}: {old} there, {value} here" if short else key
    return "the images' names"


def alike(a: dict[str, Any], b: dict[str, Any]) -> bool:
    """Whether two manifests are of one batch; its environments may lie in another folder."""
    return _without_paths(a) == _without_paths(b)


def laid_out(manifest: dict[str, Any]) -> str:
    """A manifest as text: one line for each entry of its lists."""
    blocks = []
    for key, value in manifest.items():
        if isinstance(value, list):
            text = "[\n" + ",\n".join(f"  {json.dumps(entry)}" for entry in value) + "\n ]"
        else:
            text = json.dumps(value)
        blocks.append(f" {json.dumps(key)}: {text}")
    return "{\n" + ",\n".join(blocks) + "\n}\n"


def _every(made_of: dict[str, Any]) -> Iterator[Job]:
    environments, rotations, materials, cameras = (len(made_of[key]) for key in LISTS)
    return jobs(cameras, environments, rotations, materials)


def _without_paths(manifest: dict[str, Any]) -> dict[str, Any]:
    """All but the environments' paths: from another folder they are others, to the same files."""
    lights = manifest.get("environments")
    if not isinstance(lights, list):
        return manifest
    return {
        **manifest,
        "environments": [
            {key: value for key, value in own.items() if key != "file"} if isinstance(own, dict) else own
            for own in lights
        ],
    }
