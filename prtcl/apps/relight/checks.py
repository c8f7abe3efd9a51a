"""What is wrong with a batch, found before its first image: options, maps, views, and outputs that are inputs."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from glob import has_magic
from pathlib import Path
from typing import Any

from prtcl.apps.relight.names import plain
from prtcl.errors import InputError
from prtcl.scene.bake import is_bake
from prtcl.scene.camera import Camera
from prtcl.scene.camera_path import View
from prtcl.scene.frames import Job, Sources
from prtcl.scene.frames_view import NOT_TAKEN
from prtcl.scene.plan import check_error

MOST_STOPS = 1000


def check_options(options: argparse.Namespace) -> None:
    """Refuse options that contradict one another, before anything is read."""
    if not abs(options.exposure) <= MOST_STOPS:
        raise InputError(
            f"--exposure {options.exposure}: expected stops between -{MOST_STOPS} and {MOST_STOPS}"
        )
    if options.samples is not None and not 1 <= options.samples <= 64:
        raise InputError(
            f"--samples {options.samples}: expected 1 to 64, N x N sub-pixel points of every pixel"
        )
    if not options.output:
        raise InputError("--output: expected a folder, got no name")
    for text in options.env:
        path = Path(text)
        folder = path if path.is_dir() else path.parent if has_magic(text) and not path.exists() else None
        if folder is not None and folder.resolve() == Path(options.output).resolve():
            raise InputError(
                f"--output {options.output}: is where --env looks for maps, and the next run would take images for "
                "them; choose another folder"
            )
    if is_bake(options.mesh) and options.points == "pixel":
        raise InputError(
            f"--points pixel: {options.mesh} holds the rays of vertices, not of pixels; relight the mesh it was made of"
        )
    if is_bake(options.mesh) and options.keep_visibility is not None:
        raise InputError(
            f"--keep-visibility: {options.mesh} holds its visibility already; leave one of them out"
        )
    if options.factorization == "view":
        given = [name for name in NOT_TAKEN if getattr(options, name) is not None]
        if options.error is not None or given:
            raise InputError(
                f"--{given[0] if given else 'error'}: is of --factorization light, and view has no use for it; "
                "leave one of them out"
            )
    if options.error is not None:
        check_error(options.error)
        if options.samples is not None or options.rays is not None:
            raise InputError("--error: finds --samples and --rays; leave these out, or --error")
        if options.points == "vertex" or is_bake(options.mesh):
            raise InputError(
                "--error: seeks the points of pixels; fix --levels and --rays of vertices by hand"
            )
    if options.turntable is not None and options.cameras is not None:
        raise InputError("--turntable and --cameras: expected one of them, got both")
    several = "--turntable" if options.turntable is not None else "--cameras" if options.cameras else None
    if several and options.eye is not None:
        raise InputError(f"--eye: {several} says where the eyes are; leave one of them out")
    if options.cameras and options.target is not None:
        raise InputError("--target: --cameras says where cameras look; leave one of them out")
    if options.elevation is not None and options.turntable is None:
        raise InputError("--elevation: is that of a --turntable; give both, or --eye")


def check_inputs(
    missing: Iterable[Job], views: list[View], sources: Sources, check: Callable[[Camera], object],
    progress: Callable[[int, int], object] | None = None,
) -> None:  # fmt: skip
    """Read every map and try every view that missing images need, so that no bad one ends a long run in its midst.

    A map of a gigabyte is read twice so: once here, once when its turn comes.

    Parameters
    ----------
    check : called with the camera of each view, to raise what is wrong with it
    progress : called with the number of maps read, and of all

    Raises
    ------
    InputError
        If a map cannot be read or holds what is no radiance; what `check` raises, with the view's name.
    """
    jobs = list(missing)
    for view in sorted({job.view for job in jobs}):
        try:
            check(views[view].camera)
        except InputError as error:
            raise InputError(f"{plain(views[view].name)}: {error}") from error
    lights = sorted({job.light for job in jobs})
    for done, light in enumerate(lights, start=1):
        sources.read(light)
        if progress is not None:
            progress(done, len(lights))


def refuse_inputs(output: Path, manifest: dict[str, Any], sources: list[Path]) -> None:
    """Refuse a batch that would replace a file that it reads."""
    real = {source.resolve(): source for source in sources}
    if output.resolve() not in {path.parent for path in real}:
        return
    for entry in manifest["frames"]:
        for name in (entry[key] for key in ("file", "png") if key in entry):
            if (output / name).resolve() in real:
                raise InputError(
                    f"{output / name}: is an input of this job and would be overwritten; choose another folder with -o"
                )
