"""What views see, kept in a folder from one job to the next: a store of bits for each view and grid of rays.

Rays are most of what a view costs before its first light, and what they find depends on neither light nor material.
So they are kept, and nothing that is made of them: V ⊕ f_v of one material takes a hundred times the bytes, and is made
of the bits again in a fraction of the time of the rays, a coloured one sooner than it is read (bench/view_costs.py).
Camera rays are shot again; the points that they give are part of what a store is made of, so that bits are used for the
very points they were traced from, or not at all.

DIR/KEY.zarr is one view, KEY the beginning of the hash of all that its bits depend on. What does not match or is
damaged is traced anew and replaced, with the reason told: the folder saves time, and never decides what images are.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from prtcl import quadtree
from prtcl._version import __version__
from prtcl.errors import InputError, PrtclError
from prtcl.factors import pixel_visibility, refine, sphere
from prtcl.factors.pixel_visibility import Pixels
from prtcl.files.array_store import ArrayStore, import_zarr, write_store
from prtcl.files.digest import arrays_sha256, json_sha256
from prtcl.scene.camera import Camera
from prtcl.scene.mesh import Mesh
from prtcl.transport.fixed_view import Bits
from prtcl.transport.pipeline import Points

FORMAT = 1
KIND = "prtcl visibility"
WHAT = "visibility kept by `prtcl relight --keep-visibility`"
KEY_DIGITS = 20
DAY = 86400.0
_ASIDE = re.compile(r"\.[0-9a-f]{32}\.zarr")
"""Stores written aside (`prtcl.files.folder.replacing_folder`)."""


class KeptVisibility:
    """A folder of kept visibility, for the views of one mesh.

    Parameters
    ----------
    folder : made when something is kept
    mesh : that rays are traced against
    note : called with what was found, kept or traced anew, and why

    Raises
    ------
    InputError
        If the folder is a file or cannot be made, or zarr is not installed.
    """

    def __init__(
        self, folder: str | os.PathLike[str], mesh: Mesh, note: Callable[[str], object] | None = None
    ) -> None:
        import_zarr()
        self.folder, self._note = Path(folder), note
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(
                f"{self.folder}: expected a folder to keep visibility in, cannot be made: {error.strerror}"
            ) from error
        self._sweep()
        self._of = {
            "prtcl": __version__,
            "embreex": version("embreex"),
            "mesh": mesh.name,
            "mesh_sha256": arrays_sha256({"vertices": mesh.vertices, "faces": mesh.faces}),
        }

    def of_pixels(
        self, camera: Camera, levels: int, points: Points, pixels: Pixels, trace: Callable[[], Bits]
    ) -> Bits:
        """Which cells of the sphere each pixel of a view sees, as `trace` gives it.

        See `prtcl.factors.pixel_visibility.soft_visibility`, which `trace` calls, and `FixedView`'s keeper.
        """
        leave = {
            "origins": points.origins, "normals": points.frames[:, 2], "first": pixels.first, "phase": pixels.phase
        }  # fmt: skip
        rays = {"of": "pixels", "levels": levels, "blocks": pixel_visibility.BLOCKS}
        return self._bits(camera, leave, rays, trace, (len(pixels), sphere.n_cells(levels) // 32))

    def of_points(
        self, camera: Camera, points: Points, levels: int, mode: str, trace: Callable[[], Bits]
    ) -> Bits:
        """What each sub-pixel point of a view sees of its hemisphere, as `trace` gives it.

        See `Tracer.visibility`, which `trace` calls; `mode` is that of `Settings.visibility`.
        """
        leave = {"origins": points.origins, "frames": points.frames, "grid": points.grid}
        rays = {"of": "points", "levels": levels, "mode": mode, "blocks": refine.BLOCKS}
        return self._bits(camera, leave, rays, trace, (len(points), quadtree.visibility_words(levels)))

    def _bits(
        self, camera: Camera, leave: Mapping[str, npt.NDArray[Any]], rays: dict[str, Any],
        trace: Callable[[], Bits], shape: tuple[int, int],
    ) -> Bits:  # fmt: skip
        """Visibility from the folder where that has it; otherwise `trace`'s, kept there.

        Parameters
        ----------
        leave : the arrays that rays leave from
        rays : all else that they depend on, as JSON can hold it
        shape : of the bits
        """
        seen = _plain(asdict(camera))
        made_of = {**self._of, "camera": seen, "rays": rays, "points_sha256": arrays_sha256(leave)}
        path = self.folder / f"{key_of(made_of)}.zarr"
        if path.exists():
            try:
                bits = _read(path, made_of, shape)
                self._tell(f"{path}: the view's visibility was read")
                return bits
            except InputError as error:
                self._tell(f"{error}\nthe view's visibility is traced anew")
        bits = trace()
        try:
            write_store(path, {"bits": bits}, {"kind": KIND, "format": FORMAT, "made_of": made_of})
            size = ArrayStore(path, WHAT).disk_bytes
            self._tell(
                f"{path}: keeps the view's visibility, {size} bytes, {size / shape[0]:.0f} a {rays['of'][:-1]}"
            )
        except PrtclError as error:  # the images do not need it
            self._tell(f"{error}\nthe view's visibility is not kept")
        return bits

    def _sweep(self) -> None:
        """Remove what jobs that were killed have half written; other jobs may be writing, but not since yesterday."""
        for path in self.folder.glob(".*.zarr"):
            with suppress(OSError):
                if _ASIDE.fullmatch(path.name) and time.time() - path.stat().st_mtime > DAY:
                    shutil.rmtree(path)

    def _tell(self, text: str) -> None:
        if self._note is not None:
            self._note(text)


def key_of(made_of: Mapping[str, Any]) -> str:
    """What a store is called that is made of this."""
    return json_sha256(made_of)[:KEY_DIGITS]


def open_store(path: str | os.PathLike[str]) -> ArrayStore:
    """A store of kept visibility, its metadata checked.

    Raises
    ------
    InputError
        If it is missing, damaged, something else, or of another format.
    """
    store = ArrayStore(path, WHAT)
    found = store.attributes
    if found.get("kind") != KIND:
        raise InputError(f"{path}: expected {WHAT}, got a Zarr store of something else")
    if found.get("format") != FORMAT:
        raise InputError(
            f"{path}: visibility of format {found.get('format')}; this prtcl reads format {FORMAT}"
        )
    if not isinstance(found.get("made_of"), dict) or set(store.arrays) != {"bits"}:
        raise InputError(f"{path}: does not say what its visibility is of, or holds more; delete it")
    return store


def _read(path: Path, made_of: dict[str, Any], shape: tuple[int, int]) -> Bits:
    """The bits of a store, if they are of this."""
    store = open_store(path)
    given, array = store.attributes["made_of"], store.arrays["bits"]
    differ = sorted(key for key in made_of.keys() | given.keys() if made_of.get(key) != given.get(key))
    if differ:
        raise InputError(f"{path}: was made of something else: {', '.join(differ)} differ")
    if array.shape != shape or array.dtype != np.uint32:
        raise InputError(f"{path}: expected bits uint32 of shape {shape}, got {array.dtype} of {array.shape}")
    return np.asarray(store.read("bits"), dtype=np.uint32)


def _plain(value: Any) -> Any:
    """What JSON makes of it, to compare with what was read."""
    return json.loads(json.dumps(value))
